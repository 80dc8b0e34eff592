"""Device code (Warp) for batches of articulated trees; imports nothing but Warp.

The rooms below are in the order in which they may import: lanes, tree, effects, contact, points, tasks, touch.
"""

import warp as wp

# Warp greets and writes a line for each module that it loads, over the output of whoever uses bough as a library. Any
# level but Warp's own is the user's choice, and so is what is set later.
if wp.config.log_level == wp.LOG_INFO:
    wp.config.log_level = wp.LOG_WARNING
