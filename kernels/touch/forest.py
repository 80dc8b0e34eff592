"""A forest of decision trees: a thread walks all trees for some worlds, from the root of each to a leaf.

    p = (1 / T) sum_t leaf_t(x),   right where x[feature] > threshold, as scikit-learn walks

Children lie side by side: the left one at ``child``, the right one behind it. A leaf is its own left child and its
threshold is infinite, so that all worlds make as many steps as the tree is deep and none asks whether it is done. On a
CPU a thread takes many worlds through one tree before the next, which stays in its first cache meanwhile, and eight of
them side by side, so that they wait for memory together.
"""

from functools import cache
from typing import Any

import warp as wp

__all__ = ["LANES", "TOGETHER", "Node", "vote_kernel"]

#: Worlds that a thread takes on a CPU, and how many of them side by side; their features stay in its cache.
TOGETHER = 64
LANES = 8


@wp.struct
class Node:
    """A split or a leaf: which feature is asked, the left child, the threshold; the share of contacts at a leaf."""

    feature: int
    child: int
    threshold: float
    share: float


@cache
def vote_kernel(lanes: int) -> Any:
    """Return the kernel ``vote`` for so many worlds side by side."""
    count = int(lanes)
    Nodes = wp.types.vector(length=count, dtype=int)

    @wp.kernel(enable_backward=False, module="unique")
    def vote(
        features_in: wp.array2d(dtype=wp.float32), due_in: wp.array(dtype=wp.bool), root_in: wp.array(dtype=int),
        depth_in: wp.array(dtype=int), node_in: wp.array(dtype=Node), threshold: float, first: int, last: int,
        worlds: int, probability_out: wp.array(dtype=wp.float32), flag_out: wp.array(dtype=wp.float32),
    ):  # fmt: skip
        """Write the probability of contact of some worlds from ``first`` to ``last``, and 1 where above the threshold.

        Where fewer than all lanes are left, the last world fills the others. Worlds that are not due keep their flag.
        """
        begin = first + wp.tid() * worlds
        end = wp.min(begin + worlds, last)
        asked = wp.int32(0)
        for w in range(begin, end):
            asked = asked + wp.where(due_in[w], 1, 0)
        if asked == 0:
            return
        for w in range(begin, end):
            probability_out[w] = 0.0
        for t in range(root_in.shape[0]):
            for w in range(begin, end, wp.static(count)):
                at = Nodes()
                for k in range(wp.static(count)):
                    at[k] = root_in[t]
                for _step in range(depth_in[t]):
                    for k in range(wp.static(count)):
                        x = features_in[wp.min(w + k, end - 1), node_in[at[k]].feature]
                        at[k] = node_in[at[k]].child + wp.where(x > node_in[at[k]].threshold, 1, 0)
                for k in range(wp.static(count)):
                    if w + k < end:
                        probability_out[w + k] = probability_out[w + k] + node_in[at[k]].share
        for w in range(begin, end):
            p = probability_out[w] / float(root_in.shape[0])
            probability_out[w] = p
            if due_in[w]:
                flag_out[w] = wp.where(p > threshold, 1.0, 0.0)

    return vote
