"""Runs the exported controller without qjrl and jax: python run_onnx.py outputs/default/deploy (needs onnxruntime)."""

import hashlib
import json
import sys
import time
from pathlib import Path

import numpy as np
import onnxruntime

onnxruntime.set_default_logger_severity(3)  # errors alone: it warns of every constant that it removes
folder = Path(sys.argv[1])
contract = json.loads((folder / "contract.json").read_text())
sessions = {}
for name, described in contract["functions"].items():
    content = (folder / f"{name}.onnx").read_bytes()
    assert hashlib.sha256(content).hexdigest() == described["files"][f"{name}.onnx"]["sha256"], f"{name}: another file"
    sessions[name] = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])


def call(name, arrays):
    """A function of the files on named arrays."""
    ports = contract["functions"][name]
    given = {port["name"]: np.asarray(arrays[port["name"]], port["dtype"]) for port in ports["inputs"]}
    outputs = [port["name"] for port in ports["outputs"]]
    return dict(zip(outputs, sessions[name].run(outputs, given), strict=True))


record = np.load(folder / "log.npz")  # a record of the arm; on a robot, the encoders
rows = np.flatnonzero(record["episode"] == 0)
state = {"target": record["target"][0], "base_lengths": record["base_lengths"][0], "reading": record["reading"][0]}
state |= call("begin_target", state)
answer, difference, seconds = {}, 0.0, []
for row in rows:
    begin = time.perf_counter()
    answer = call("control_step", state | {"reading": record["reading"][row]})
    seconds.append(time.perf_counter() - begin)
    state |= {name.removeprefix("next_"): array for name, array in answer.items() if name.startswith("next_")}
    difference = max(difference, float(np.abs(state["command"] - record["command"][row]).max()))
print(f"motors at {np.round(np.degrees(answer['motor_angles']), 2)} deg after {len(rows)} steps")
print(f"commands within {1e6 * difference:.2g} um of the record's; {1e3 * np.median(seconds):.2f} ms a step (median)")
