"""What all commands share: exit codes.

Uses: nothing but Python.
"""
