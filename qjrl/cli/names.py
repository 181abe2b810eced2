"""Names of directories that come from values of the configuration, as resolvers of OmegaConf in `conf/config.yaml`."""

import hashlib
import re

from qjrl.pipeline import check_name

LONGEST = 180
"""Bytes of the name of a job's directory; file systems take 255."""


def register() -> None:
    """Makes ``${run_name:...}`` and ``${job_name:...}`` known."""
    from omegaconf import OmegaConf

    OmegaConf.register_new_resolver("run_name", check_name, replace=True)
    OmegaConf.register_new_resolver("job_name", job_name, replace=True)


def job_name(swept: str) -> str:
    """``seed=1,robot=my_arm`` as the name of one directory, whatever the values hold; another for other values."""
    name = re.sub(r"[^\w.,=+\-\[\]@~ ]|^\.", "_", str(swept))
    if name == swept and len(name.encode()) <= LONGEST and name.strip(". "):
        return name
    kept = name.encode()[:LONGEST].decode(errors="ignore").strip()
    return f"{kept}~{hashlib.sha256(str(swept).encode(errors='surrogateescape')).hexdigest()[:8]}"
