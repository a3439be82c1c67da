"""Pictures for print: that what is in front is what is seen."""

import numpy as np
import trimesh

from palmar.eval.picture import HAPTIC, Body, Camera, capsule, draw, object_body

CAMERA = Camera(np.eye(3), np.zeros(3), 0.024)  # from +z


def ball(x, radius, colour, z=0.0):
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    points = np.asarray(mesh.vertices) + np.array([x, 0, z])
    return Body(points, np.asarray(mesh.faces), np.asarray(mesh.vertex_normals), colour)


def test_the_nearer_body_hides_the_farther_and_the_ghost_shines_through():
    red, green = ball(0, 0.01, (1.0, 0, 0)), ball(0, 0.004, (0, 1.0, 0), z=0.01)
    image = draw([red, green], None, CAMERA, 48)
    assert image[24, 24, 1] > 0.4 > image[24, 24, 0] and image[24, 40, 0] > 0.3 > image[24, 40, 1]
    assert image[0, 0, 3] == 0 and image[24, 24, 3] == 1
    ghost = draw([red], ball(0, 0.005, HAPTIC), CAMERA, 48)  # inside: seen through the red ball
    assert 0.1 < ghost[24, 24, 2] < 0.6 and ghost[24, 24, 0] > 0.3


def test_a_capsule_is_the_hull_of_its_balls():
    c1, c2 = np.zeros(3), np.array([0, 0, 0.03])
    points, _, normals = capsule(c1, 0.01, c2, 0.006)
    nearest = np.minimum(
        np.abs(np.linalg.norm(points - c1, axis=1) - 0.01), np.abs(np.linalg.norm(points - c2, axis=1) - 0.006)
    )
    assert nearest.max() < 1e-12 and np.allclose(np.linalg.norm(normals, axis=1), 1)


def test_an_object_keeps_its_creases():
    box = trimesh.creation.box((1, 1, 1))
    body = object_body(np.asarray(box.vertices), np.asarray(box.faces))
    assert (np.abs(body.normals).max(axis=1) > 0.999).all()  # each vertex has the normal of one side
