"""The step of worlds in which an arm, branches, a line and the ground touch: one kernel, any number of substeps.

A step places arm and branches, lists what may touch (`find`), folds the branches' inertia without contact
(`tree.articulated`), solves arm and contacts of every world together (`space`), and moves both on.
"""

from functools import cache
from typing import Any

import warp as wp

from ..effects.step import term_functions, term_types, time_of
from ..effects.terms import Term
from ..lanes.real import SOURCE
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
from .space import (
    load_link,
    mark_paths,
    note_response,
    press_links,
    respond,
    set_out_contacts,
    solve_contacts,
    summed,
    turns_of,
)

__all__ = ["contact_step_kernel"]


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
def solve_world(w: int, row: int, width: int, a: Any, y: Any, k: Any, rule: ContactRule, p: Any, tall: Any, h: float):
    """Solve the arm and all contacts of a world, until the set of joints at their torque limit stands."""
    count = rule.count[w]
    turns = turns_of(count, width)
    changed = int(1)
    for _attempt in range(TRIES):
        if changed == 1:
            free_arm(w, a, y, k, h)
            if count > 0:
                v = k.velocity[w]
                for n in range(count):
                    c = rule.record[w, n]
                    sign = wp.where(c.link > 0, -1.0, 1.0)
                    J, Y = response(w, k, c.body, c.other, c.point, sign, p.frame[row, n], tall)
                    note_response(row, n, turns, J, Y, v, p)
                rule.unsettled[w] = solve_contacts(row, count, turns, rule.friction[w], rule, p, v, h)
                push_arm(w, k, summed(row, count, turns, p, v), h)
            changed = judge_servos(w, a, y, k, h)


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
                set_out_contacts(e, row, lane_, w, width, m, s, rule, p, dt, h)
            solve_world(w, row, width, a, y, k, rule, p, tall, dt)
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


@cache
def contact_step_kernel(width: int, dof: int, terms: tuple[Term, ...] = ()) -> Any:
    """Return the kernel ``step`` for a lane width and an arm with ``dof`` joints (float32).

    With terms the branches obey their laws, and the loads ``u_in``; without, neither is read.
    """
    t, arm = contact_types(width, 32), arm_types(dof)
    Model, State, Scratch, Load, Shapes, Touch = t.Model, t.State, t.Scratch, t.Load, t.Shapes, t.Touch
    Arm, ArmState, ArmWork, Tall = arm.Arm, arm.ArmState, arm.ArmWork, arm.Tall
    Space, ArmLanes, Terms = t.Space, arm_lanes(width), term_types(width, 32).Terms
    laws, with_laws, W = term_functions(width, 32, terms), int(len(terms) > 0), width
    start, feel, fold = laws.start, laws.feel, laws.fold

    # loops over joints stay loops: unrolled, they made the compiler work for a minute
    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def step(
        m: Model, x_in_out: State, a: Arm, y_in_out: ArmState, k_out: ArmWork, rule: ContactRule, shapes: Shapes,
        touch_out: Touch, space_out: Space, g_out: ArmLanes, u_in: Load, fx: Terms, worlds_in: wp.array2d(dtype=int),
        s_out: Scratch, first: int, row: int, substeps: int, h: wp.float64, bound: wp.float64,
    ):  # fmt: skip
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        slot_world = worlds_in[0]  # a table of one row: Warp compiles a kernel that takes a plain array twice
        if wp.static(with_laws):
            start(e, r, m, fx, s_out, h * wp.float64(substeps))
        for k in range(substeps):
            place_root(e, r, m, s_out)
            place_links(e, r, m, x_in_out, s_out)
            find_contacts(e, r, W, slot_world, m, s_out, a, y_in_out, k_out, g_out, rule, shapes, touch_out,
                          wp.float32(h))  # fmt: skip
            if wp.static(with_laws):
                time = time_of(e, fx, k, h)
                feel(e, r, m, fx, s_out, time)
                fold(e, r, m, x_in_out, u_in, fx, s_out, h, time)
            else:
                fold_links(e, r, m, x_in_out, s_out, h)
            answer_contacts(e, r, W, slot_world, m, s_out, a, y_in_out, k_out, rule, touch_out, space_out, Tall(), h)
            advance_links(e, r, m, x_in_out, s_out, h, bound)
            x_in_out.tick[e] = x_in_out.tick[e] + 1
        end_poses(e, r, W, slot_world, a, y_in_out, g_out)

    return step
