"""Clouds of points: drawing them, embeddings, nearest distances, ray-traced pictures.

Uses: `kernels.lanes`.
"""
