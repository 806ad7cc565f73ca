"""Faults: what must not be destroyed, and what must not destroy.

Each module is a subject with a table of cases; `test_fuzz.py` mutates what is read. Both drive the
command line only, each command in a process of its own, so that a crash is caught and counts.
"""
