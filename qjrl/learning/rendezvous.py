"""Processes wait for each other before JAX's distributed runtime starts, which ends a process that waits in vain by a signal.

The first listens at the address that the runtime will use; each of the others says its number there and goes on when the
first says that all have come.
"""

import contextlib
import socket
import time
from collections.abc import Iterator

from qjrl.machine import MachineError

_GREETING, _GO = "qjrl process", b"go\n"
_PAUSE = 0.2
"""Seconds between two attempts to reach the first process."""


def wait_for_all(coordinator: str, count: int, index: int, patience: float) -> None:
    """Returns once all processes have come.

    Args:
        coordinator: HOST:PORT at which they meet; number 0 listens there, at every address of its machine.
        patience: longest wait [s].
    Raises:
        MachineError: somebody has not come by then, or the first one's machine cannot listen at that port.
    """
    host, _, port = coordinator.rpartition(":")
    deadline = time.monotonic() + patience
    if index == 0:
        _gather(int(port), count, deadline, patience)
    else:
        _follow(host.strip("[]"), int(port), index, deadline, patience)


def _gather(port: int, count: int, deadline: float, patience: float) -> None:
    came: dict[int, socket.socket] = {}
    with contextlib.ExitStack() as stack:
        try:
            listener = stack.enter_context(_listener(port))
        except OSError as error:
            raise MachineError(f"processes.coordinator: cannot listen at port {port} ({error.strerror})") from error
        while missing := [str(index) for index in range(1, count) if index not in came]:
            for guest in _guests(listener, deadline):
                stack.callback(guest.close)
                if (number := _number_of(guest)) is not None:
                    came[number] = guest  # one that was started again takes the place of its first try
                    came = {other: line for other, line in came.items() if _is_there(line)}
                    break
            else:
                raise MachineError(
                    f"processes: waited {patience:g} s at port {port} for {count - 1} others, "
                    f"of which number {', '.join(missing)} did not come"
                )
        for guest in came.values():
            with contextlib.suppress(OSError):  # it has just gone; JAX's runtime will say so
                guest.sendall(_GO)


def _listener(port: int) -> socket.socket:
    if socket.has_dualstack_ipv6():
        return socket.create_server(("", port), family=socket.AF_INET6, dualstack_ipv6=True)
    return socket.create_server(("", port))


def _guests(listener: socket.socket, deadline: float) -> Iterator[socket.socket]:
    """Those who connect until the deadline."""
    while (left := deadline - time.monotonic()) > 0:
        listener.settimeout(left)
        try:
            yield listener.accept()[0]
        except TimeoutError:
            return


def _number_of(guest: socket.socket) -> int | None:
    """The number that a process says; None: it is no process of ours."""
    guest.settimeout(5.0)
    try:
        said = guest.makefile("rb").readline(64).decode(errors="replace").strip()
    except OSError:
        return None
    words, _, number = said.rpartition(" ")
    return int(number) if words == _GREETING and number.isdecimal() else None


def _is_there(guest: socket.socket) -> bool:
    """Whether the process behind a connection still holds it."""
    guest.setblocking(False)
    try:
        return guest.recv(1, socket.MSG_PEEK) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


def _follow(host: str, port: int, index: int, deadline: float, patience: float) -> None:
    reason = "no answer"
    while (left := deadline - time.monotonic()) > 0:
        try:
            with socket.create_connection((host, port), timeout=left) as line:
                if line.getsockname() != line.getpeername():  # a port of one's own machine may answer itself
                    line.sendall(f"{_GREETING} {index}\n".encode())
                    line.settimeout(max(deadline - time.monotonic(), 0.01))
                    if line.makefile("rb").readline(64) == _GO:
                        return
                    reason = "it ended the connection"
        except TimeoutError:
            reason = "it waits for others, or does not answer"
        except OSError as error:
            reason = error.strerror or str(error)
        time.sleep(min(_PAUSE, max(deadline - time.monotonic(), 0.0)))
    raise MachineError(f"processes: waited {patience:g} s for the first process at {host}:{port} ({reason})")
