"""Gusts of any course in time: whether a branch sways untouched, and the course that every recording shows."""
