# MuJoCo's compiled names are unknown to type checkers: everything in it is Any.
from typing import Any

def __getattr__(name: str) -> Any: ...
