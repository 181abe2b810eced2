"""Runs the exported forward model without qjrl and jax: python run_onnx.py outputs/default/export (needs onnxruntime)."""

import hashlib
import json
import sys
from pathlib import Path

import numpy as np
import onnxruntime

folder = Path(sys.argv[1])
contract = json.loads((folder / "contract.json").read_text())
described = contract["functions"]["forward_model"]
content = (folder / "forward_model.onnx").read_bytes()
expected = described["files"]["forward_model.onnx"]["sha256"]
assert hashlib.sha256(content).hexdigest() == expected, "forward_model.onnx: another file"

session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
strokes = np.array([cable["high"] for cable in contract["cables"]], contract["precision"])
lengths = 0.3 * strokes * np.linspace(-1.0, 1.0, 7, dtype=strokes.dtype)[:, None]  # seven commands [m]
(poses,) = session.run(["pose"], {described["inputs"][0]["name"]: lengths})
matrix, limit = np.array(contract["bends"]["from_cable_lengths"]), contract["bends"]["limit"]
for row, pose in zip(lengths, np.asarray(poses), strict=True):
    bends = np.linalg.norm((matrix @ row).reshape(-1, 2), axis=1)
    allowed = "within" if bends.max() <= limit else "beyond"
    print(f"cables {np.round(1e3 * row, 1)} mm, {allowed} the limits: tip at {np.round(1e3 * pose[:3], 1)} mm")
