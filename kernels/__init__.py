"""Device code (Warp) for batches of articulated trees; imports nothing but Warp.

The rooms below are in the order in which they may import: lanes, tree, effects, contact, points, tasks.
"""
