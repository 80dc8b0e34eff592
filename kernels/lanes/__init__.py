"""Scalars and vectors of the kernels, for one world a thread or 8 and 16 in vector lanes; random numbers; threads.

Uses: nothing but Warp.
"""
