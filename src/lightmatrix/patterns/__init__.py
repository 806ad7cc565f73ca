"""Patterns as linear operators: what the projector shows."""
