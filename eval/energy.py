"""Energy of the virtual spring between haptic and graphic hand, and what a user put in and got back. docs/metrics.md.

Everything is in the object's frame, where contacts that do not stick can do no work: U may change by the work of the
haptic hand's motion alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from palmar.eval.case import Case, NotMeasured
from palmar.eval.judge import Poses, graphic_poses, haptic_poses
from palmar.model import HandModel

Array = NDArray[np.float64]
LEAST_J = 1.25e-6  # of 0.05 N on a spring of 1 N/mm: below it shares of an energy say nothing
CLOSED = 1e-5, 1e-4  # metres, rad: how near to its start a closed loop ends


def spring_energy(hand: HandModel, graphic: Poses, haptic: Poses, *, abduction: bool = False) -> Array:
    """(n,) J: 1/2 (q_g - q_h)^T G (q_g - q_h) over palm and flexions, with abduction over it as well.

    Abduction is copied and has no stiffness of its own in G; where it counts it has that of its finger's first joint.
    """
    way = graphic.palm_position_m - haptic.palm_position_m
    turn = (_of_quaternion(graphic.palm_rotation_wxyz) * _of_quaternion(haptic.palm_rotation_wxyz).inv()).as_rotvec()
    bend = graphic.flexion_rad - inside_limits(haptic.flexion_rad, hand.flexion_limit_rad)
    twice = (
        hand.palm_stiffness_n_per_m[0] * (way**2).sum(axis=1)
        + hand.palm_rotation_stiffness_n_m_per_rad[0] * (turn**2).sum(axis=1)
        + (hand.joint_stiffness_n_m_per_rad * bend**2).sum(axis=(1, 2))
    )
    if abduction:
        spread = graphic.abduction_rad - inside_limits(haptic.abduction_rad, hand.abduction_limit_rad)
        twice += (hand.joint_stiffness_n_m_per_rad[:, 0] * spread**2).sum(axis=1)
    return 0.5 * twice


def inside_limits(angles_rad: Array, limit_rad: Array) -> Array:
    """Angles (n, ...) cut at the limits (..., 2): where the springs of a sample beyond a joint limit start."""
    return np.clip(angles_rad, limit_rad[..., 0], limit_rad[..., 1])


def work_of_user(case: Case) -> Array:
    """(n,) J put in by the haptic hand's motion since the first step: W_n = -sum 1/2 (F_k + F_(k-1)) . dq_h,k."""
    run = case.run
    object_from_world = _of_quaternion(run.object_rotation_wxyz).inv()
    place, rotation, bend = _haptic_in_object(case)
    power = (
        (_mean(object_from_world.apply(run.palm_force_n)) * np.diff(place, axis=0)).sum(axis=1)
        + (_mean(object_from_world.apply(run.palm_torque_n_m)) * _turns(rotation)).sum(axis=1)
        + (_mean(run.joint_torque_n_m) * np.diff(bend, axis=0)).sum(axis=(1, 2))
    )
    return np.concatenate([[0.0], -np.cumsum(power)])


def _haptic_in_object(case: Case) -> tuple[Array, Rotation, Array]:
    """Palm position (n, 3), palm rotation (n), flexion (n, 5, 3)."""
    run = case.run
    object_from_world = _of_quaternion(run.object_rotation_wxyz).inv()
    return (
        object_from_world.apply(run.haptic_palm_position_m - run.object_position_m),
        object_from_world * _of_quaternion(run.haptic_palm_rotation_wxyz),
        inside_limits(run.haptic_flexion_rad, case.pack.hand.flexion_limit_rad),
    )


def _of_quaternion(wxyz: Array) -> Rotation:
    return Rotation.from_quat(np.roll(wxyz, -1, axis=1))


def _mean(values: Array) -> Array:
    return 0.5 * (values[1:] + values[:-1])


def _turns(rotation: Rotation) -> Array:
    """(n - 1, 3) rad."""
    return (rotation[1:] * rotation[:-1].inv()).as_rotvec() if len(rotation) > 1 else np.zeros((0, 3))


def _stored(case: Case) -> Array:
    """(n,) J of the graphic against the haptic hand."""
    stored = spring_energy(case.pack.hand, graphic_poses(case.run), haptic_poses(case.run))
    if stored.max() < LEAST_J:
        raise NotMeasured(f"the spring never holds {1e6 * LEAST_J:g} uJ, that of 0.05 N")
    return stored


def energy_generated(case: Case) -> Array:
    """(n,) % of the largest U: energy in the spring, and given back so far, that the user did not put in."""
    stored = _stored(case)
    return 100 * np.maximum(0, stored - stored[0] - work_of_user(case)) / stored.max()


def energy_lost(case: Case) -> Array:
    """(k,) %: of each closed loop the absolute work of the user by the largest U of the run.

    Loops are phases named loop; without one it is the whole run if it starts and ends with an empty spring.
    """
    stored, work = _stored(case), work_of_user(case)
    loops = [_loop_ends(case, phase) for phase in case.phase_slices("loop")]
    if not loops:
        if max(stored[0], stored[-1]) > LEAST_J:
            raise NotMeasured("no phase named loop, and the run does not start and end without force")
        loops = [(0, -1)]
    return np.array([100 * abs(work[last] - work[first]) / stored.max() for first, last in loops])


def _loop_ends(case: Case, phase: slice) -> tuple[int, int]:
    """First step of the loop and the one that closes it: that at the phase's end, or the last before."""
    place, rotation, bend = _haptic_in_object(case)
    missed = []
    for last in (min(phase.stop, len(place) - 1), phase.stop - 1):
        ends = [phase.start, last]
        way = float(np.linalg.norm(np.diff(place[ends], axis=0)))
        turn = max(float(np.linalg.norm(_turns(rotation[ends]))), float(np.abs(np.diff(bend[ends], axis=0)).max()))
        if way <= CLOSED[0] and turn <= CLOSED[1]:
            return phase.start, last
        missed.append(f"{1e3 * way:.3g} mm, {turn:.3g} rad")
    raise NotMeasured(f"a phase named loop ends {missed[0]} from where it started")
