"""What a real rig does wrong, found in the capture itself, named, and taken out of T.

Each fault changes photograph k, to first order, by a small number times an image that T predicts.
`choice.py` fits all numbers at once to what the strongest entries of each row of T cannot explain,
and keeps the terms that are there; `model.py` takes them out of the capture.
To add a term, write a file with a subclass of `Term` (`term.py`), and name it in `terms.py`.
"""
