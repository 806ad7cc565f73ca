"""The report of an estimate: one self-contained page of HTML.

Each section has a file in `sections/`, which builds it from the elements of `elements.py`. The
templates lay out each kind of element.
"""
