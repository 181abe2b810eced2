"""What the numbers say: metrics, tables, figures (the only matplotlib), MuJoCo pictures, the report."""
