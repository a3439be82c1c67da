"""How many spheres of one common excess any choice needs for an error: a bound from below."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import coo_array, eye_array, hstack, vstack

from palmar.tools.medial import medial_balls, merged_indices, within
from palmar.tools.set_cover import find_incidence
from palmar.tools.solid import make_solid, sample_surface

Array = NDArray[np.float64]

MOST_BALLS = 3_000  # beyond, the programme takes hours
_SAMPLES_A_BALL, _CANDIDATES_A_BALL = 12, 10


def least_spheres(vertices_m: Array, faces: NDArray[np.integer], error_m: float, leaves: Array, seed: int = 0) -> float:
    """The least weight of candidates that covers 99 % of surface samples within a gap and a protrusion of error_m.

    Each candidate may be taken in part, so no choice among them has fewer: the linear relaxation of set cover (Lovasz
    1975), each sample covered or among the 1 %. leaves (n, 4): a cover that is there, which are among the candidates;
    the others are medial balls, tight and slack, ten for each leaf. Raises BadMesh.
    """
    assert len(leaves) <= MOST_BALLS, f"{len(leaves)} leaves; a bound for at most {MOST_BALLS} is computed"
    solid = make_solid(vertices_m, faces)
    budget = 2 * error_m
    own = solid.triangles.distances(np.ascontiguousarray(leaves[:, :3]))
    points, face = sample_surface(solid, max(600, _CANDIDATES_A_BALL * len(leaves) // 2), seed + 31)
    tried = [medial_balls(solid, points, face, slack) for slack in (0.02 * budget, 0.4 * budget)]
    others = within(solid, np.concatenate(tried))
    balls = np.concatenate([own, others[merged_indices(others, budget)]])
    samples, _ = sample_surface(solid, max(2_000, _SAMPLES_A_BALL * len(leaves)), seed + 32)
    pairs = find_incidence(balls, samples, budget)
    owner = np.repeat(np.arange(len(balls)), np.diff(pairs.start))
    covers = coo_array((np.ones(len(owner)), (pairs.sample, owner)), shape=(len(samples), len(balls)))
    # x in covers @ x + left >= 1, sum(left) <= 1 %.
    rows = vstack(
        [
            hstack([-covers, -eye_array(len(samples))]),
            coo_array(np.concatenate([np.zeros(len(balls)), np.ones(len(samples))])[None, :]),
        ]
    ).tocsr()
    limits = np.concatenate([-np.ones(len(samples)), [0.01 * len(samples)]])
    weight = np.concatenate([np.ones(len(balls)), np.zeros(len(samples))])
    found = linprog(weight, A_ub=rows, b_ub=limits, bounds=(0, None), method="highs-ipm")
    assert found.status == 0, found.message
    return float(found.fun)
