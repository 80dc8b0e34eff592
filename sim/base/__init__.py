"""What every room of the simulator stands on: errors, files, console, quaternions, the machine, threads.

Uses: `kernels.lanes`.
"""
