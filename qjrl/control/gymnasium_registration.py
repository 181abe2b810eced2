"""What Gymnasium calls when it is imported (entry point `gymnasium.envs`); imports nothing of ours."""


def register() -> None:
    """Registers `Residual-v0` in the namespace that the entry point names, `qjrl`."""
    import gymnasium

    adapter = "qjrl.control.gymnasium_adapter"
    gymnasium.register("Residual-v0", entry_point=f"{adapter}:make", vector_entry_point=f"{adapter}:make_vec")
