"""How good an estimate is: against a known matrix, and by its own diagnostics."""
