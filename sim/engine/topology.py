"""Link order and grouping: which worlds share a thread, and where each link of each tree sits in it.

A tree's links are put into one order that depends on the tree alone: depth first, siblings by kind of joint and then
by size of their subtrees. Trees of one group are overlaid child by child; a world leaves the links it lacks masked.
Since siblings keep their order, every sum over children is made in the same order alone and in any group.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..base import rotation
from ..base.types import Array, IntArray
from ..trees.tree import Joint, Tree


@dataclass
class Node:
    """One place of an overlay: the kind of its joint and its children. ``link`` is the tree's own index."""

    kind: int
    link: int = -1
    children: list[Node] = field(default_factory=list)
    size: int = 1


@dataclass(frozen=True)
class Layout:
    """Where everything sits.

    Attributes:
        world_slot: Slot of each world, shape [worlds]; slot = group * width + lane.
        parent: Parent of each place, shape [groups, places + 1]; place 0 is the world.
        kind: Kind of joint of each place, shape [groups, places + 1].
        count: Places in use in each group, shape [groups].
        place: Place of every link of every world, one array per world.
        free: How the trees of each group are held (`freedom`), shape [groups].
    """

    world_slot: IntArray
    parent: IntArray
    kind: IntArray
    count: IntArray
    place: list[IntArray]
    free: IntArray


def ordered(tree: Tree) -> Node:
    """Return the tree under a root node that stands for the world, siblings in their canonical order."""
    nodes = [Node(int(k), i) for i, k in enumerate(tree.joint)]
    root = Node(-1)
    for i in range(tree.num_links - 1, -1, -1):
        above = nodes[tree.parent[i]] if tree.parent[i] >= 0 else root
        above.children.append(nodes[i])
        above.size += nodes[i].size
    for node in (root, *nodes):
        node.children.sort(key=lambda n: (n.kind, -n.size, n.link))
    return root


def _pairs(target: Node, source: Node) -> list[tuple[Node, Node]]:
    """Pair the children of two nodes in order within each kind of joint; ``target`` may have more than ``source``."""
    out: list[tuple[Node, Node]] = []
    for kind in sorted({c.kind for c in source.children}):
        ours, theirs = ([c for c in node.children if c.kind == kind] for node in (target, source))
        out += zip(ours, theirs, strict=False)
    return out


def overlay(target: Node, source: Node) -> None:
    """Extend ``target`` in place so that it holds ``source``: children pair up in order within each kind of joint."""
    todo = [(target, source)]  # no recursion here and below: a chain may be thousands of links long
    while todo:
        ours, theirs = todo.pop()
        have, need = (Counter(c.kind for c in node.children) for node in (ours, theirs))
        ours.children += [Node(kind) for kind, count in need.items() for _ in range(count - have[kind])]
        ours.children.sort(key=lambda n: n.kind)
        todo += _pairs(ours, theirs)


def numbered(root: Node) -> tuple[list[int], list[int]]:
    """Assign each node its number in ``link``, depth first from 1; return parents and kinds with the world at 0."""
    parent, kind = [0], [0]
    root.link = 0
    todo = [(child, root) for child in reversed(root.children)]
    while todo:
        node, above = todo.pop()
        node.link = len(parent)
        parent.append(above.link)
        kind.append(node.kind)
        todo += [(child, node) for child in reversed(node.children)]
    return parent, kind


def places(target: Node, source: Node, out: IntArray) -> None:
    """Write the place in ``target`` (numbered) of every link of ``source`` into ``out``."""
    todo = _pairs(target, source)
    while todo:
        ours, theirs = todo.pop()
        out[theirs.link] = ours.link
        todo += _pairs(ours, theirs)


def _signature(tree: Tree) -> bytes:
    return tree.parent.tobytes() + b"|" + tree.joint.tobytes()


def _shape_key(root: Node) -> tuple[int, ...]:
    """Degrees in depth-first order: trees that sort side by side overlay well."""
    key: list[int] = []
    stack = [root]
    while stack:
        node = stack.pop()
        key.append(len(node.children))
        stack.extend(reversed(node.children))
    return (root.size, *key)


def arrange(trees: Sequence[Tree], width: int) -> Layout:
    """Arrange one world per tree in groups of ``width``; like topologies share groups.

    With one world a group the slots are in the order of the worlds.
    """
    distinct = {id(t): t for t in trees}  # a batch is often one tree many times
    facts = {key: (_signature(t), freedom(t)) for key, t in distinct.items()}
    signatures = [facts[id(t)][0] for t in trees]
    unique: dict[bytes, Node] = {}
    for tree, signature in zip(trees, signatures, strict=True):
        if signature not in unique:
            unique[signature] = ordered(tree)
    rank = {s: r for r, s in enumerate(sorted(unique, key=lambda s: (_shape_key(unique[s]), s)))}
    free = np.array([facts[id(t)][1] for t in trees])
    order = np.arange(len(trees))
    if width > 1:
        order = np.lexsort((order, np.array([rank[s] for s in signatures]), free))
    # trees that nothing holds step differently: they share no thread with others
    alike = [order[free[order] == f] for f in np.unique(free)] if width > 1 else [order]
    groups = [part[g : g + width] for part in alike for g in range(0, len(part), width)]
    layout = _fill(trees, signatures, unique, groups, width)
    return replace(layout, free=np.array([free[members[0]] for members in groups]))


def freedom(tree: Tree) -> int:
    """Return how a tree is held: 0 by something, 1 on an unsprung ball, 2 on three crossed slides and such a ball.

    The numbers are those of `kernels.tree.momentum`.
    """
    roots = np.flatnonzero(tree.parent < 0)
    loose = (tree.stiffness + tree.damping + tree.armature + np.abs(tree.preload).sum(axis=1)) == 0.0
    if len(roots) != 1 or not loose[roots[0]]:
        return 0
    if tree.joint[roots[0]] == Joint.SPHERICAL:
        return 1
    link, pose = int(roots[0]), np.array([1.0, 0.0, 0.0, 0.0])
    axes: list[Array] = []
    while len(axes) < 3 and tree.joint[link] == Joint.PRISMATIC and loose[link]:
        pose = rotation.quat_multiply(pose, tree.rotation[link])
        axes.append(rotation.quat_rotate(pose, tree.axis[link]))
        below = np.flatnonzero(tree.parent == link)
        if len(below) != 1:
            return 0
        link = int(below[0])
    crossed = len(axes) == 3 and np.allclose(np.array(axes) @ np.array(axes).T, np.eye(3), atol=1e-9)
    return 2 if crossed and tree.joint[link] == Joint.SPHERICAL and loose[link] else 0


def _fill(
    trees: Sequence[Tree], signatures: list[bytes], unique: dict[bytes, Node], groups: list[IntArray], width: int
) -> Layout:
    rows: list[tuple[list[int], list[int]]] = []
    place: list[IntArray] = [np.zeros(0, np.int64)] * len(trees)
    slot = np.zeros(len(trees), np.int64)
    cache: dict[tuple[bytes, ...], tuple[list[int], list[int], dict[bytes, IntArray]]] = {}
    for g, members in enumerate(groups):
        key = tuple(sorted({signatures[w] for w in members}))
        if key not in cache:
            cache[key] = _group(key, unique)
        parent, kind, where = cache[key]
        rows.append((parent, kind))
        for lane, w in enumerate(members):
            place[w] = where[signatures[w]]
            slot[w] = g * width + lane
    longest = max(len(p) for p, _ in rows)
    parents = np.zeros((len(rows), longest), np.int64)
    kinds = np.zeros((len(rows), longest), np.int64)
    for g, (parent, kind) in enumerate(rows):
        parents[g, : len(parent)], kinds[g, : len(kind)] = parent, kind
    count = np.array([len(p) - 1 for p, _ in rows])
    return Layout(slot, parents, kinds, count, place, np.zeros_like(count))


def _group(key: tuple[bytes, ...], unique: dict[bytes, Node]) -> tuple[list[int], list[int], dict[bytes, IntArray]]:
    union = Node(-1)
    for signature in key:
        overlay(union, unique[signature])
    parent, kind = numbered(union)
    where = {}
    for signature in key:
        where[signature] = np.zeros(unique[signature].size - 1, np.int64)
        places(union, unique[signature], where[signature])
    return parent, kind, where
