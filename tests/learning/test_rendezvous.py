import contextlib
import socket
import threading
import time

import pytest

from qjrl.learning.rendezvous import wait_for_all
from qjrl.machine import MachineError


@pytest.fixture
def port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def meeting(port: int, count: int, indices: list[int], patience: float = 20.0) -> dict[int, str]:
    """Index -> its error, or "" for those who went on; the later in `indices`, the later they come."""
    found: dict[int, str] = {}

    def come(index: int) -> None:
        try:
            wait_for_all(f"127.0.0.1:{port}", count, index, patience)
            found[index] = ""
        except MachineError as error:
            found[index] = str(error)

    threads = []
    for index in indices:
        threads.append(threading.Thread(target=come, args=(index,)))
        threads[-1].start()
        time.sleep(0.05)
    for thread in threads:
        thread.join()
    return found


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 1, 0], [1, 0, 2]])
def test_all_go_on_once_all_have_come_in_whatever_order(port, order) -> None:
    assert meeting(port, 3, order) == {0: "", 1: "", 2: ""}


def test_those_who_wait_in_vain_say_for_whom(port) -> None:
    found = meeting(port, 3, [0, 2], patience=0.6)
    assert found[0] == f"processes: waited 0.6 s at port {port} for 2 others, of which number 1 did not come"
    assert found[2].startswith(f"processes: waited 0.6 s for the first process at 127.0.0.1:{port} (")


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere.invalid:1"])
def test_a_first_process_that_is_not_there_is_named_with_the_reason(address) -> None:
    start = time.monotonic()
    with pytest.raises(MachineError, match=rf"waited 0\.3 s for the first process at {address} \(.+\)"):
        wait_for_all(address, 2, 1, 0.3)
    assert time.monotonic() - start < 10.0


def test_a_port_that_is_taken_is_said_at_once(port) -> None:
    with socket.create_server(("", port)), pytest.raises(MachineError, match=f"cannot listen at port {port}"):
        wait_for_all(f"127.0.0.1:{port}", 2, 0, 60.0)


def test_a_stranger_is_no_process_of_ours_and_one_that_starts_again_counts_once(port) -> None:
    found: dict[int, str] = {}
    first = threading.Thread(target=lambda: found.update(meeting(port, 3, [0])))
    first.start()
    for words in (b"GET / HTTP/1.1\r\n", b"\xff\xfe\n", b"qjrl process one\n", b"qjrl process 1\n"):
        with contextlib.closing(connected(port)) as stranger:
            stranger.sendall(words)
    assert meeting(port, 3, [2, 1]) == {1: "", 2: ""}  # who comes last is the one whose first try is gone
    first.join()
    assert found == {0: ""}


def connected(port: int) -> socket.socket:
    for _ in range(100):
        with contextlib.suppress(OSError):
            return socket.create_connection(("127.0.0.1", port))
        time.sleep(0.05)
    raise AssertionError(port)
