"""Touch felt in joint torques: what a driver tells, features of every world's last samples, a forest of decision trees.

Uses: `kernels.lanes`, `kernels.tasks`.
"""
