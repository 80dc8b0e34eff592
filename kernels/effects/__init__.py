"""Laws that a branch may obey beside its springs: how they plug in, the step, replay and inverse dynamics with them.

These kernels define no operators, so Warp's own key sees every change in them: this folder is no part of
`real.SOURCE`, and work on it leaves all other kernels' binaries valid.

Uses: `kernels.lanes`, `kernels.tree`.
"""
