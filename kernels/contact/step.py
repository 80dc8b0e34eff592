"""The step of worlds in which an arm, branches, a line and the ground touch.

A step places arm and branches, lists what may touch (`find`), folds the branches' inertia without contact
(`tree.articulated`), solves arm and contacts of every world together (`space`, `solve`), and moves both on.

On a CPU one kernel does it for any number of substeps, a group of worlds in lanes. On a GPU three kernels make a
substep: what comes before the contacts and what comes after, a thread a world, and between them the contacts of a
world by a warp. One thread would keep all others waiting for the world with the most contacts.
"""

from functools import cache
from typing import Any, NamedTuple

import warp as wp

from ..effects.step import term_functions, term_types, time_of
from ..effects.terms import Term
from ..lanes.real import SOURCE
from ..lanes.team import TEAM, meet
from ..tree.articulated import advance_links, fold_links, place_links, place_root
from ..tree.observe import locate_joints
from .arm import (
    TRIES,
    arm_dynamics,
    arm_lanes,
    arm_types,
    end_pose,
    finish_arm,
    free_arm,
    judge_servos,
    obey,
    place_group,
    push_arm,
    response,
    take_arm,
)
from .find import find_arm_contacts, find_branch_contacts, find_crossings, note_arms, note_line
from .law import ContactRule, contact_types
from .solve import note_response, solve_contacts, summed
from .space import find_yields, load_link, mark_paths, press_links, respond, set_out_contacts, turns_of

__all__ = ["StepParts", "contact_step_kernel", "contact_step_parts"]


# ---- one world -------------------------------------------------------------------------------------------------------


@wp.func(inline=True)
def set_out(
    w: int, row: int, lane_: int, a: Any, y: Any, k: Any, g: Any, rule: ContactRule, touch: Any, h: float
):  # fmt: skip
    """Clear what the last step found in a world, and find what its arm touches beside branches."""
    take_arm(w, row, lane_, k, g)
    obey(w, a, y)
    rule.count[w] = 0
    rule.depth[w] = 0.0
    rule.unsettled[w] = 0
    speed = float(0.0)
    for j in range(y.force.shape[1]):
        y.force[w, j] = wp.vec3(0.0, 0.0, 0.0)
        # the servo may bring a joint to its target within the step
        speed = speed + wp.max(wp.abs(y.qd[w, j]), wp.abs(y.obeyed[w, j])) * a.reach[j]
    for c in range(rule.branch_force.shape[1]):
        rule.branch_force[w, c] = wp.vec3(0.0, 0.0, 0.0)
    note_line(w, row, lane_, a.shape_link.shape[0], rule, touch, speed)
    find_arm_contacts(w, row, lane_, a, g, rule, 1.0e-3 + h * speed)


@wp.func(inline=True)
def move_freely(w: int, a: Any, y: Any, k: Any, h: float):
    """Solve the arm of a world without contacts, until the set of joints at their torque limit stands."""
    changed = int(1)
    for _attempt in range(TRIES):
        if changed == 1:
            free_arm(w, a, y, k, h)
            judge_servos(w, a, y, k, h)
            changed = k.changed[w]


@wp.func(inline=True)
def solve_world(
    w: int, row: int, thread: int, threads: int, width: int, a: Any, y: Any, k: Any, rule: ContactRule, p: Any,
    tall: Any, h: float,
):  # fmt: skip
    """Solve the arm and all contacts of a world, until the set of joints at their torque limit stands."""
    count = rule.count[w]
    turns = turns_of(count, width)
    changed = int(1)
    for _attempt in range(TRIES):
        if changed == 1:
            meet(row, threads, p)
            if thread == 0:
                free_arm(w, a, y, k, h)
            meet(row, threads, p)
            v = k.velocity[w]
            for n in range(thread, count, threads):
                c = rule.record[w, n]
                sign = wp.where(c.link > 0, -1.0, 1.0)
                J, Y = response(w, k, c.body, c.other, c.point, sign, p.frame[row, n], tall)
                note_response(row, n, turns, J, Y, v, p)
            meet(row, threads, p)
            unsettled = solve_contacts(row, thread, threads, count, turns, rule.friction[w], rule, p, v, h)
            meet(row, threads, p)
            if thread == 0:
                rule.unsettled[w] = unsettled
                push_arm(w, k, summed(row, count, turns, p, v), h)
                judge_servos(w, a, y, k, h)
            meet(row, threads, p)
            changed = k.changed[w]


@wp.func(inline=True)
def note_forces(w: int, row: int, lane_: int, y: Any, rule: ContactRule, touch: Any, p: Any):
    """Hand the forces to the branches, and sum them for every link of the arm and every capsule of the branches."""
    for n in range(rule.count[w]):
        c = rule.record[w, n]
        f = wp.transpose(p.frame[row, n]) * p.force[row, n]
        rule.record[w, n].force = f
        if c.link > 0:
            load_link(row, lane_, c.link, c.lever, f, touch)
            rule.branch_force[w, c.capsule] = rule.branch_force[w, c.capsule] + f
            if c.second_link > 0:
                load_link(row, lane_, c.second_link, c.second_lever, wp.vec3(0.0, 0.0, 0.0) - f, touch)
                rule.branch_force[w, c.second_capsule] = rule.branch_force[w, c.second_capsule] - f
            if c.body >= 0:
                y.force[w, c.body] = y.force[w, c.body] - f
        else:
            y.force[w, c.body] = y.force[w, c.body] + f
            if c.other >= 0:
                y.force[w, c.other] = y.force[w, c.other] - f
    for j in range(y.force.shape[1]):
        rule.arm_peak[w, j] = wp.max(rule.arm_peak[w, j], wp.length(y.force[w, j]))


# ---- a group of worlds -----------------------------------------------------------------------------------------------


@wp.func(inline=True)
def find_contacts(
    e: int, row: int, width: int, slot_world: wp.array(dtype=int), m: Any, s: Any, a: Any, y: Any, k: Any, g: Any,
    rule: ContactRule, shapes: Any, touch: Any, h: float,
):  # fmt: skip
    """Place the arms beside placed branches, and list what touches or may touch within the step."""
    locate_joints(e, row, m, s, touch.at, touch.velocity)
    place_group(e, row, width, slot_world, a, y, g)
    arm_dynamics(row, a, g)
    note_arms(row, a, g, touch)
    with_line = int(0)
    for lane_ in range(width):
        w = slot_world[e * width + lane_]
        if w >= 0:
            set_out(w, row, lane_, a, y, k, g, rule, touch, h)
            with_line = wp.max(with_line, rule.line_mask[w])
    find_branch_contacts(e, row, width, slot_world, a, g, rule, shapes, s, touch, with_line, h)
    if rule.branch_branch == 1:
        find_crossings(e, row, width, slot_world, rule, shapes, s, touch, h)


@wp.func(inline=True)
def answer_contacts(
    e: int, row: int, width: int, slot_world: wp.array(dtype=int), m: Any, s: Any, a: Any, y: Any, k: Any,
    rule: ContactRule, touch: Any, p: Any, tall: Any, h: wp.float64,
):  # fmt: skip
    """Solve arm and contacts of every world, take the arms' step, and press the folded branches with the forces."""
    dt = wp.float32(h)
    todo = mark_paths(e, row, width, slot_world, m, rule, touch)
    if todo == 1:
        respond(e, row, m, s, touch, h)
    for lane_ in range(width):
        w = slot_world[e * width + lane_]
        if w >= 0:
            if rule.count[w] > 0:
                set_out_contacts(e, row, lane_, w, m, s, rule, p, dt, h)
                find_yields(row, 0, 1, w, width, rule, p)
                solve_world(w, row, 0, 1, width, a, y, k, rule, p, tall, dt)
            else:
                move_freely(w, a, y, k, dt)
            note_forces(w, row, lane_, y, rule, touch, p)
            finish_arm(w, a, y, k, dt)
    if todo == 1:
        press_links(e, row, m, s, touch, h)


@wp.func(inline=True)
def end_poses(e: int, row: int, width: int, slot_world: wp.array(dtype=int), a: Any, y: Any, g: Any):
    """Place the arms and write the end-effectors' poses of a group's worlds."""
    place_group(e, row, width, slot_world, a, y, g)
    for lane_ in range(width):
        w = slot_world[e * width + lane_]
        if w >= 0:
            end_pose(w, row, lane_, a, y, g)


# ---- kernels ---------------------------------------------------------------------------------------------------------


@cache
def _approach(width: int, terms: tuple[Term, ...]) -> Any:
    """Return the function of what a substep does before contacts are answered.

    With terms the branches obey their laws, and the loads ``u``; without, neither is read.
    """
    laws, with_laws = term_functions(width, 32, terms), int(len(terms) > 0)
    start, feel, fold = laws.start, laws.feel, laws.fold

    def approach(
        e: int, row: int, step: int, substeps: int, slot_world: wp.array(dtype=int), m: Any, x: Any, a: Any, y: Any,
        k: Any, g: Any, rule: ContactRule, shapes: Any, touch: Any, u: Any, fx: Any, s: Any, h: wp.float64,
    ):  # fmt: skip
        """Place arms and branches, list what may touch, fold the branches' inertia; of so many substeps this one."""
        if wp.static(with_laws):
            if step == 0:
                start(e, row, m, fx, s, h * wp.float64(substeps))
        place_root(e, row, m, s)
        place_links(e, row, m, x, s)
        find_contacts(e, row, wp.static(width), slot_world, m, s, a, y, k, g, rule, shapes, touch, wp.float32(h))
        if wp.static(with_laws):
            time = time_of(e, fx, step, h)
            feel(e, row, m, fx, s, time)
            fold(e, row, m, x, u, fx, s, h, time)
        else:
            fold_links(e, row, m, x, s, h)

    return wp.func(approach, name=f"approach_{start.key}", inline=True)


@cache
def contact_step_kernel(width: int, dof: int, terms: tuple[Term, ...] = ()) -> Any:
    """Return the kernel ``step`` of any number of substeps, for a lane width and an arm of ``dof`` joints (float32).

    Args:
        width: Worlds of a group.
        dof: Joints of the arm.
        terms: Laws that the branches obey beside springs; with them the loads ``u_in`` are read.
    """
    t, arm = contact_types(width, 32), arm_types(dof)
    Model, State, Scratch, Load, Shapes, Touch = t.Model, t.State, t.Scratch, t.Load, t.Shapes, t.Touch
    Arm, ArmState, ArmWork, Tall = arm.Arm, arm.ArmState, arm.ArmWork, arm.Tall
    Space, ArmLanes, Terms = t.Space, arm_lanes(width), term_types(width, 32).Terms
    approach, W = _approach(width, terms), width

    # loops over joints stay loops: unrolled, they made the compiler work for a minute
    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def step(
        m: Model, x_in_out: State, a: Arm, y_in_out: ArmState, k_out: ArmWork, rule: ContactRule, shapes: Shapes,
        touch_out: Touch, space_out: Space, g_out: ArmLanes, u_in: Load, fx: Terms, worlds_in: wp.array2d(dtype=int),
        s_out: Scratch, first: int, row: int, substeps: int, h: wp.float64, bound: wp.float64,
    ):  # fmt: skip
        """Advance a group, branches and arms in contact, by ``substeps`` steps of ``h`` [s]."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        slot_world = worlds_in[0]  # a table of one row: Warp compiles a kernel that takes a plain array twice
        for k in range(substeps):
            approach(e, r, k, substeps, slot_world, m, x_in_out, a, y_in_out, k_out, g_out, rule, shapes, touch_out,
                     u_in, fx, s_out, h)  # fmt: skip
            answer_contacts(e, r, W, slot_world, m, s_out, a, y_in_out, k_out, rule, touch_out, space_out, Tall(), h)
            advance_links(e, r, m, x_in_out, s_out, h, bound)
            x_in_out.tick[e] = x_in_out.tick[e] + 1
        end_poses(e, r, W, slot_world, a, y_in_out, g_out)

    return step


class StepParts(NamedTuple):
    """The kernels of one substep of worlds that have a thread each, in their order; ``solve`` has a team each."""

    approach: Any
    solve: Any
    leave: Any


@cache
def contact_step_parts(dof: int, terms: tuple[Term, ...] = (), team: int = TEAM) -> StepParts:
    """Return the three kernels of a substep, for lanes of one world; arguments as in `contact_step_kernel`.

    ``approach`` takes the number of the substep in the launch and their number beside; ``leave`` whether it is the
    last. ``solve`` has dimensions [worlds, threads of a team that run it]; ``thread`` is the first of those.
    """
    t, arm = contact_types(1, 32), arm_types(dof)
    Model, State, Scratch, Load, Shapes, Touch = t.Model, t.State, t.Scratch, t.Load, t.Shapes, t.Touch
    Arm, ArmState, ArmWork, Tall = arm.Arm, arm.ArmState, arm.ArmWork, arm.Tall
    Space, ArmLanes, Terms = t.Space, arm_lanes(1), term_types(1, 32).Terms
    come = _approach(1, terms)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def approach(
        m: Model, x_in: State, a: Arm, y_in_out: ArmState, k_out: ArmWork, rule: ContactRule, shapes: Shapes,
        touch_out: Touch, space_out: Space, g_out: ArmLanes, u_in: Load, fx: Terms, worlds_in: wp.array2d(dtype=int),
        s_out: Scratch, step: int, substeps: int, h: wp.float64,
    ):  # fmt: skip
        """Place arm and branches of world e, list its contacts, and set them out where anything touches."""
        tag = SOURCE  # noqa: F841
        e = wp.tid()
        slot_world = worlds_in[0]
        come(e, e, step, substeps, slot_world, m, x_in, a, y_in_out, k_out, g_out, rule, shapes, touch_out, u_in, fx,
             s_out, h)  # fmt: skip
        if mark_paths(e, e, 1, slot_world, m, rule, touch_out) == 1:
            respond(e, e, m, s_out, touch_out, h)
            set_out_contacts(e, e, 0, slot_world[e], m, s_out, rule, space_out, wp.float32(h), h)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def solve(
        a: Arm, y_in_out: ArmState, k_out: ArmWork, rule: ContactRule, space_out: Space,
        worlds_in: wp.array2d(dtype=int), thread: int, h: wp.float64,
    ):  # fmt: skip
        """Solve arm and contact forces of world e, a team of threads at once; skip a world without contacts."""
        tag = SOURCE  # noqa: F841
        e, j = wp.tid()
        w = worlds_in[0, e]
        if w >= 0:
            if rule.count[w] > 0:
                find_yields(e, thread + j, wp.static(team), w, 1, rule, space_out)
                solve_world(w, e, thread + j, wp.static(team), 1, a, y_in_out, k_out, rule, space_out, Tall(),
                            wp.float32(h))  # fmt: skip

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def leave(
        m: Model, x_in_out: State, a: Arm, y_in_out: ArmState, k_out: ArmWork, rule: ContactRule, touch_out: Touch,
        space_out: Space, g_out: ArmLanes, worlds_in: wp.array2d(dtype=int), s_out: Scratch, h: wp.float64,
        bound: wp.float64, last: int,
    ):  # fmt: skip
        """Move arm and branches of world e on by ``h`` [s] under the contacts' forces, if there are any."""
        tag = SOURCE  # noqa: F841
        e = wp.tid()
        slot_world = worlds_in[0]
        w = slot_world[e]
        if w >= 0:
            if rule.count[w] == 0:
                move_freely(w, a, y_in_out, k_out, wp.float32(h))
            note_forces(w, e, 0, y_in_out, rule, touch_out, space_out)
            finish_arm(w, a, y_in_out, k_out, wp.float32(h))
            if rule.count[w] > 0:
                press_links(e, e, m, s_out, touch_out, h)
        advance_links(e, e, m, x_in_out, s_out, h, bound)
        x_in_out.tick[e] = x_in_out.tick[e] + 1
        if last == 1:
            end_poses(e, e, 1, slot_world, a, y_in_out, g_out)

    return StepParts(approach, solve, leave)
