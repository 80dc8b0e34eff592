"""Measured cases, inference of parameters, prediction and reports."""
