"""What each metric means, in words for the reader of a report. Formulas: docs/metrics.md."""

MEANING = {
    "penetration_spheres": (
        "Deepest overlap of the graphic hand, exact shape, with the leaf spheres: the error of the solver. "
        "The paper reports about 0.1 mm."
    ),
    "penetration_mesh": (
        "Deepest point of the graphic hand inside the true mesh: error of the solver and of the sphere model together."
    ),
    "penetration_hand_mesh": (
        "Deepest point of the hand's own mesh inside the true mesh of the object: true surface against true surface. "
        "Only fitted hands have a mesh."
    ),
    "hover": "Gap to the true mesh of a phalanx that reports contact: the hand stops before it touches.",
    "wrong_side": "Steps in which a link ends on the far side of a plate or shell.",
    "force_variation": (
        "Change of fingertip force from step to step in the hold phase, as a share of the force (floor 0.05 "
        "N). Mostly it measures the sensor: read it with the ratio."
    ),
    "force_variation_ratio": (
        "Force variation divided by what the haptic hand alone would cause with the graphic hand frozen; 1 is "
        "a solver that adds nothing."
    ),
    "excess_force_step": "Change of force in one step beyond what the motion of the haptic hand explains.",
    "friction_force": (
        "What of the palm's force no contact explains by pushing along its normal: friction, where there should be "
        "none, or a step that has not converged. Small beside the force itself."
    ),
    "still_force_step": "Change of force in a step while the input is constant.",
    "contact_toggles": "Changes of the set of contacts a second while the input is constant: chatter.",
    "force_above_20hz": "Part of the force above 20 Hz while sliding: what is felt as roughness.",
    "force_ripple": (
        "Peak to peak of the force while sliding at constant commanded depth; 7 % of 2 N is just noticeable."
    ),
    "energy_generated": (
        "Energy in the virtual spring, and given back, that the user did not put in: a hand that pushes by itself."
    ),
    "energy_lost": (
        "Work that a closed loop of the haptic hand took and did not give back: friction that nobody modelled."
    ),
    "joint_step_excess": (
        "Step of a graphic joint beyond that of the haptic joint (and beyond 1 degree): the jumps that a user sees."
    ),
    "free_lag": "Difference of graphic and haptic hand where nothing is near.",
    "palm_offset": (
        "Distance of graphic and haptic palm. Penetration near zero is cheap when the hand lags, so read both."
    ),
    "cost_excess": (
        "Objective above that of a converged solution for palm and fingers together: from the same start (mean, p99), "
        "and of a reference run on its own way (own)."
    ),
    "frozen_steps": "Steps in which the previous pose was published again because no better one could be verified.",
    "recovery": "Time from the end of a disturbance until all limits hold again.",
    "contacts": "Contact pairs handled in a step.",
    "step_cpu": "Thread CPU time of one step.",
    "step_wall": "Wall time of one step; other work on the machine is in it.",
    "step_operations": "Operations used by a step (docs/settings.md).",
    "protrusion": "How far the leaf spheres bulge out of the true mesh: the error of the model, outwards.",
    "gap": "How far the true mesh lies outside the leaf spheres: the error of the model, inwards.",
    "normal_error": "Angle between the normals of sphere union and mesh, as a fingertip feels them.",
    "spheres": "Leaf spheres of the level used.",
    "bytes": "Size of the pack.",
}
