"""Questions asked of controllers on held-out targets: each file is one study, with its configuration and numbers."""
