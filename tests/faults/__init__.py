"""Faults: what must not be destroyed, and what must not destroy.

`cases/` is the table, one small file a subject; `fuzz/` mutates what is read. Both drive the
command line only, each command in a process of its own, so that a crash is caught and counts.

    python -m tests.faults.table            the table, counted by outcome
    python -m tests.faults.fuzz --count 500 mutations, or --case 1234 for one again
"""
