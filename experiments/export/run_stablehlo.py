"""Runs an export without qjrl: python run_stablehlo.py outputs/default/export (needs jax alone)."""

import hashlib
import json
import sys
from pathlib import Path

import jax
import numpy as np

folder = Path(sys.argv[1])
contract = json.loads((folder / "contract.json").read_text())
jax.config.update("jax_enable_x64", contract["precision"] == "float64")
loaded = {}
for name in ("forward_model", "inverse_kinematics"):
    content = (folder / f"{name}.stablehlo").read_bytes()
    expected = contract["functions"][name]["files"][f"{name}.stablehlo"]["sha256"]
    assert hashlib.sha256(content).hexdigest() == expected, f"{name}.stablehlo: another file"
    loaded[name] = jax.jit(jax.export.deserialize(bytearray(content)).call)

strokes = np.array([cable["high"] for cable in contract["cables"]], contract["precision"])
lengths = 0.2 * strokes * np.linspace(-1.0, 1.0, 7, dtype=strokes.dtype)[:, None]  # seven commands [m]
targets = loaded["forward_model"](lengths)["pose"]
answer = loaded["inverse_kinematics"](targets)
angles = np.degrees(np.asarray(answer["cable_lengths"]) * contract["motors"]["angle_per_length"]["value"])
for row in range(len(targets)):
    print(f"tip at {np.round(1e3 * np.asarray(targets[row, :3]), 1)} mm: motors at {np.round(angles[row], 1)} deg")
print(f"converged: {answer['converged']}, largest error {1e3 * answer['position_error'].max():.4f} mm")
