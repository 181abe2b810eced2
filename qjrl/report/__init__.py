"""The kit that shows numbers: metrics, tables, figures, drawings of the arm, pages; a subfolder for each stage with its own."""
