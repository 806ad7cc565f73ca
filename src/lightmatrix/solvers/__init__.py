"""Estimators of rows of the light transport matrix, one problem and one result for all."""
