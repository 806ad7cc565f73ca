"""The report of an estimate: one page of HTML that stands by itself.

A section a file (`sections/`), made of the blocks of `blocks.py`, which the templates lay out.
"""
