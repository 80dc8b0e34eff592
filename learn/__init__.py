"""Measured cases, inference, what a model lacks, tasks and policies, reports."""
