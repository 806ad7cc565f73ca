"""The report of an estimate: one self-contained page of HTML; and views of T as files.

`sections.py` builds the sections from the elements of `elements.py`. The templates lay out each
kind of element. `views.py` is `lm.show`.
"""
