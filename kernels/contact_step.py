"""The step of worlds in which an arm, branches, a line and the ground touch: one kernel, any number of substeps."""

from functools import cache
from typing import Any

import warp as wp

from .arm import add_point_force, arm_dynamics, arm_functions, arm_types, end_pose, place_arm, point_velocity
from .articulated import advance_links, place_links, place_root
from .contact import (
    MISS,
    ContactRule,
    add_to_link,
    clear_link,
    contact_types,
    fold_touched,
    impedance,
    judge,
    lane_vec,
    mark_paths,
    respond,
    spring,
    stiffen,
)
from .contact_find import find_arm_contacts, find_branch_contacts, note_arm
from .observe import locate_joints
from .real import SOURCE

__all__ = ["contact_step_kernel"]


@cache
def contact_step_kernel(width: int, dof: int) -> Any:
    """Return the kernel ``step`` for a lane width and an arm with ``dof`` joints (float32)."""
    t = contact_types(width, 32)
    Model, State, Scratch, Shapes, Touch = t.Model, t.State, t.Scratch, t.Shapes, t.Touch
    arm = arm_types(dof)
    Arm, ArmState, ArmWork, Row = arm.Arm, arm.ArmState, arm.ArmWork, arm.Row
    functions = arm_functions(dof)
    solve_arm, compliance, finish_arm = functions.solve_arm, functions.compliance, functions.finish_arm
    W = width

    @wp.func(inline=True)
    def set_out(
        w: int, row: int, lane_: int, a: Arm, y: ArmState, k: ArmWork, rule: ContactRule, touch: Touch, h: float
    ):
        """Place the arm and find what it touches beside branches."""
        place_arm(w, a, y.q, k)
        arm_dynamics(w, a, y, k)
        rule.count[w] = 0
        rule.depth[w] = 0.0
        k.load[w] = Row()
        k.loose[w] = 0
        now = Row()
        speed = float(0.0)
        for j in range(dof):
            now[j] = y.qd[w, j]
            y.force[w, j] = wp.vec3(0.0, 0.0, 0.0)
            # the servo may bring a joint to its target within the step
            speed = speed + wp.max(wp.abs(y.qd[w, j]), wp.abs(y.target[w, j])) * a.reach[j]
        note_arm(w, row, lane_, a, k, rule, touch, speed)
        find_arm_contacts(w, a, k, rule, now, 1.0e-3 + h * speed, h)
        for n in range(rule.count[w]):
            c = rule.record[w, n]
            c.impedance = impedance(c, rule, h)
            c.drive = spring(c, rule)
            rule.record[w, n] = c
        k.velocity[w] = now

    @wp.func(inline=True)
    def press(w: int, row: int, lane_: int, k: ArmWork, rule: ContactRule, touch: Touch, h: float):
        """Bring all contacts of a world up to date and add the branches' to their links.

        A world that has settled adds what it added before, so that its result does not depend on the others' repeats.
        """
        sharing = float(0.0)
        for n in range(rule.count[w]):
            c = rule.record[w, n]
            if c.link > 0 and c.body >= 0 and c.active == 1:
                sharing = sharing + 1.0
        for n in range(rule.count[w]):
            c = rule.record[w, n]
            if c.active == 1:
                if c.link > 0:
                    if k.settled[w] == 0:
                        v_a = wp.vec3(0.0, 0.0, 0.0)
                        if c.body >= 0:
                            c.compliance = compliance(w, k, c.body, c.point)
                            v_a = point_velocity(w, k, c.body, c.point, k.velocity[w])
                        c = stiffen(c, rule, v_a, sharing, h)
                        rule.record[w, n] = c
                    if touch.touched[row, c.link] == 0:
                        clear_link(row, c.link, touch)
                        touch.touched[row, c.link] = 1
                    add_to_link(row, lane_, c, touch, h)
                elif k.settled[w] == 0:
                    c.impedance = impedance(c, rule, h)
                    rule.record[w, n] = c

    @wp.func(inline=True)
    def gather(w: int, row: int, lane_: int, k: ArmWork, rule: ContactRule, s: Scratch, h: float):
        """Find the forces on the branches that came out of their solve, and what they amount to at the arm's joints."""
        k.load[w] = Row()
        for n in range(rule.count[w]):
            c = rule.record[w, n]
            if c.link > 0:
                turned = lane_vec(s.alpha[row, c.link], lane_)
                gained = lane_vec(s.accel[row, c.link], lane_) + wp.cross(turned, c.lever)
                c.force = wp.vec3(0.0, 0.0, 0.0)
                if c.active == 1:
                    c.force = c.nominal - h * (c.impedance * gained)
                    if c.body >= 0:
                        add_point_force(w, k, c.body, c.point, wp.vec3(0.0, 0.0, 0.0) - c.force)
                c.branch_now = c.branch + h * gained
                rule.record[w, n] = c

    @wp.func(inline=True)
    def answer(w: int, k: ArmWork, rule: ContactRule, h: float) -> int:
        """Judge all contacts by the velocities of branches and arm under their forces; return whether to repeat."""
        changed = int(0)
        v = k.velocity[w]
        for n in range(rule.count[w]):
            c = rule.record[w, n]
            relative = wp.vec3(0.0, 0.0, 0.0)
            if c.link > 0:
                relative = c.branch_now
                if c.body >= 0:
                    v_a = point_velocity(w, k, c.body, c.point, v)
                    relative = relative - v_a
                    if c.active == 1:
                        missed = c.impedance * (v_a - (c.still - h * (c.compliance * (c.force * c.share))))
                        if wp.length(missed) > MISS * wp.length(c.force) + 0.05:
                            changed = 1
            else:
                relative = point_velocity(w, k, c.body, c.point, v)
                if c.other >= 0:
                    relative = relative - point_velocity(w, k, c.other, c.point, v)
                c.force = wp.vec3(0.0, 0.0, 0.0)
                if c.active == 1:
                    c.force = c.drive - c.impedance * relative
            c.acted = c.force
            corrected, moved = judge(c, rule, rule.friction[w], relative, h)
            changed = wp.max(changed, moved)
            rule.record[w, n] = corrected
        return changed

    @wp.func(inline=True)
    def note_forces(w: int, y: ArmState, rule: ContactRule):
        """Sum the forces that acted: on every link of the arm and on every capsule of the branches."""
        for n in range(rule.count[w]):
            c = rule.record[w, n]
            f = c.acted
            if c.link > 0:
                rule.branch_force[w, c.capsule] = rule.branch_force[w, c.capsule] + f
                if c.body >= 0:
                    y.force[w, c.body] = y.force[w, c.body] - f
            else:
                y.force[w, c.body] = y.force[w, c.body] + f
                if c.other >= 0:
                    y.force[w, c.other] = y.force[w, c.other] - f
        for j in range(dof):
            rule.arm_peak[w, j] = wp.max(rule.arm_peak[w, j], wp.length(y.force[w, j]))

    # loops over joints stay loops: unrolled, they made the compiler work for a minute
    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def step(
        m: Model, x_in_out: State, a: Arm, y_in_out: ArmState, k_out: ArmWork, rule: ContactRule, shapes: Shapes,
        touch_out: Touch, slot_world: wp.array(dtype=int), s_out: Scratch, first: int, row: int, substeps: int,
        h: wp.float64, bound: wp.float64,
    ):  # fmt: skip
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        dt = wp.float32(h)
        for _k in range(substeps):
            place_root(e, r, m, s_out)
            place_links(e, r, m, x_in_out, s_out)
            locate_joints(e, r, m, s_out, touch_out.at, touch_out.velocity)
            with_line = int(0)
            for lane_ in range(W):
                w = slot_world[e * W + lane_]
                if w >= 0:
                    set_out(w, r, lane_, a, y_in_out, k_out, rule, touch_out, dt)
                    for c in range(rule.branch_force.shape[1]):
                        rule.branch_force[w, c] = wp.vec3(0.0, 0.0, 0.0)
                    if rule.line_mask[w] == 1:
                        with_line = 1
            find_branch_contacts(e, r, W, slot_world, a, k_out, rule, shapes, s_out, touch_out, with_line, dt)
            todo = mark_paths(e, r, W, slot_world, m, rule, touch_out)
            for lane_ in range(W):
                w = slot_world[e * W + lane_]
                if w >= 0:
                    k_out.settled[w] = 0
            solves = int(0)
            busy = int(1)
            while busy == 1:
                changed = int(0)
                for lane_ in range(W):
                    w = slot_world[e * W + lane_]
                    if w >= 0:
                        if k_out.settled[w] == 0:
                            solve_arm(w, a, y_in_out, k_out, rule.record, rule.count[w], dt)
                            moved = wp.where(rule.count[w] > 0, 1, 0)
                            if solves > 0:
                                moved = answer(w, k_out, rule, dt)
                            changed = wp.max(changed, moved)
                            k_out.settled[w] = 1 - moved
                if solves > 0:
                    if changed == 0 or solves == rule.repeats:
                        busy = int(0)
                if busy == 1:
                    for i in range(m.count[e] + 1):
                        touch_out.touched[r, i] = 0
                    if todo == 1:
                        for lane_ in range(W):
                            w = slot_world[e * W + lane_]
                            if w >= 0:
                                if rule.count[w] > 0:
                                    press(w, r, lane_, k_out, rule, touch_out, dt)
                    fold_touched(e, r, m, x_in_out, s_out, touch_out, solves, h)
                    solves = solves + 1
                    if todo == 0:
                        busy = int(0)
                    else:
                        respond(e, r, m, s_out, touch_out, h)
                        for lane_ in range(W):
                            w = slot_world[e * W + lane_]
                            if w >= 0:
                                if k_out.settled[w] == 0:
                                    gather(w, r, lane_, k_out, rule, s_out, dt)
            advance_links(e, r, m, x_in_out, s_out, h, bound)
            x_in_out.tick[e] = x_in_out.tick[e] + 1
            for lane_ in range(W):
                w = slot_world[e * W + lane_]
                if w >= 0:
                    note_forces(w, y_in_out, rule)
                    finish_arm(w, a, y_in_out, k_out, dt)
        for lane_ in range(W):
            w = slot_world[e * W + lane_]
            if w >= 0:
                place_arm(w, a, y_in_out.q, k_out)
                end_pose(w, a, y_in_out, k_out)

    return step
