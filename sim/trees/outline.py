"""What wind and fruit find of a link: its projected area, the centre of that area, its far end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..base.types import Array
from .tree import Tree


@dataclass(frozen=True)
class Outline:
    """Outlines of N links of several trees, one after the other, in body frames.

    Attributes:
        area: Projected area of a link's capsules seen from the side, length times mean diameter each [m^2], shape [N].
        centre: Centre of that area [m], shape [N, 3]; the joint's anchor where there is none.
        end: End of a capsule's axis that is furthest from the joint [m], shape [N, 3]; the centre of mass of a link
            without a capsule.
        crown: For a link that carries no other its share of the whole tree's area [m^2], else zero, shape [N].
    """

    area: Array
    centre: Array
    end: Array
    crown: Array


def outlines(trees: Sequence[Tree]) -> Outline:
    """Return the outlines of all links of all trees."""
    known = {id(tree): outline(tree) for tree in {id(t): t for t in trees}.values()}
    found = [known[id(tree)] for tree in trees]
    return Outline(*(np.concatenate([getattr(o, name) for o in found]) for name in ("area", "centre", "end", "crown")))


def outline(tree: Tree) -> Outline:
    """Return the outlines of a tree's links: each capsule is the trapezium of its two diameters."""
    link, a, b = tree.shape_link, tree.shape_radius[:, 0], tree.shape_radius[:, 1]
    along = tree.shape_end - tree.shape_start
    size = np.linalg.norm(along, axis=1) * (a + b)
    share = np.divide(a + 2.0 * b, 3.0 * (a + b), out=np.full(len(a), 0.5), where=a + b > 0)
    area, centre = np.zeros(tree.num_links), np.zeros((tree.num_links, 3))
    np.add.at(area, link, size)
    np.add.at(centre, link, size[:, None] * (tree.shape_start + share[:, None] * along))
    centre = np.divide(centre, area[:, None], out=tree.anchor.copy(), where=area[:, None] > 0)
    leaf = ~np.isin(np.arange(tree.num_links), tree.parent)
    return Outline(area, centre, _ends(tree), np.where(leaf, area.sum() / max(leaf.sum(), 1), 0.0))


def _ends(tree: Tree) -> Array:
    out, reach = tree.com.copy(), np.full(tree.num_links, -1.0)
    for point in (tree.shape_end, tree.shape_start):
        far = np.linalg.norm(point - tree.anchor[tree.shape_link], axis=1)
        for link, distance, place in zip(tree.shape_link, far, point, strict=True):
            if distance > reach[link]:
                out[link], reach[link] = place, distance
    return out
