import subprocess
import sys

COUNT = """
from qjrl.cli import process
process.prepare()
import scipy.linalg, threadpoolctl
print([pool["num_threads"] for pool in threadpoolctl.threadpool_info() if "scipy.libs" in pool["filepath"]])
"""


def test_lapack_of_scipy_has_one_thread_in_the_command():
    """On two it takes 30 to 500 times as long where the cores have other work."""
    found = subprocess.run([sys.executable, "-c", COUNT], capture_output=True, text=True, check=True)
    assert found.stdout.strip() in ("[1]", "[]"), found.stdout  # none: a SciPy built with another library
