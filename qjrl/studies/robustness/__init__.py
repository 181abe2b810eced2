"""Controllers under disturbances that none was made for: numbers, table, figure."""
