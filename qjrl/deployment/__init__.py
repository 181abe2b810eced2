"""What leaves the package for a machine that does not have it: exported functions and the contract beside them."""
