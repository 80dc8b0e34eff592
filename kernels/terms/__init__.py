"""Kernels that are built with laws (`effects`) for worlds that step freely.

They define no operators, so Warp's own key sees every change in them: this folder is no part of `real.SOURCE`, and work
on it leaves all other kernels' binaries valid.
"""
