"""A sweep whose runs are made by processes of a launcher."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from qjrl import artifacts
from qjrl.config import conf_folder

ROOT = Path(__file__).parent.parent.parent
ARM = (conf_folder() / "robot" / "qj_22.yaml").read_text().replace("link_length: 0.030", "link_length: 0.041")
SMALL = ("stages=[sample]", "sample.num_samples=4", "sample.shard_size=4")


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_a_launcher_s_processes_know_the_user_s_file_and_end_in_one_table(tmp_path, launcher) -> None:
    if launcher == "submitit_local":
        pytest.importorskip("hydra_plugins.hydra_submitit_launcher", reason="needs the extra cluster, of dev")
    (tmp_path / "mein Arm.yaml").write_text(ARM)
    command = ["-m", "qjrl", "-m", f"hydra/launcher={launcher}", "robot=mein Arm.yaml", "seed=1,-1,2", *SMALL]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, *command], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    rows = {row["job"]: row for row in json.loads((tmp_path / "outputs/default/sweep.json").read_text())}
    assert {job: row["status"] for job, row in rows.items()} == {
        "seed=1": "done",
        "seed=2": "done",
        "seed=-1": "bad input",
    }
    assert rows["seed=-1"]["error"].startswith("seed: got -1, allowed")
    assert all("robot=mein Arm.yaml" in row["overrides"] for row in rows.values())
    for seed in (1, 2):
        record = artifacts.load(tmp_path / f"outputs/default/seed={seed}/dataset/provenance.json")
        assert record["config"]["robot"]["link_length"] == 0.041 and record["seed"] == seed
    assert all(f"seed={seed}" in done.stdout for seed in (1, 2, -1))
