from qjrl.learning.tensorboard import tensorboard


def test_the_numbers_of_a_record_become_events(tmp_path):
    with tensorboard(tmp_path, counter="env_steps") as write:
        write({"env_steps": 10, "reward": 0.5, "return": None})
    (events,) = tmp_path.glob("events.*")
    assert b"reward" in events.read_bytes()
    assert b"return" not in events.read_bytes()
