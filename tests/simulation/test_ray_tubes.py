"""Second bounce, back face and multipath against closed forms and a sum by hand."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from geraf2.ops.physical_optics import SurfaceElements, physical_optics
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Wall
from geraf2.simulation.dielectric import cross_walls, slab_reflection
from geraf2.simulation.echo import EchoScene, Layer
from geraf2.simulation.multipath import multipath_echo
from geraf2.simulation.ray_tubes import (
    Film,
    SmoothMesh,
    TubeScene,
    back_face,
    behind_film,
    second_bounce,
    tube_echo,
)
from geraf2.simulation.spec import AWR1843
from helpers.antennas import blocks_of
from reference.physical_optics import crossing

C = 299792458.0
WAVEFORM = replace(AWR1843, path_bias_m=0.0, n_samples=8, sample_rate_hz=156250.0)
FREQUENCIES = WAVEFORM.frequencies_hz
K = 2 * np.pi * FREQUENCIES / C


def tube_scene(mesh, tube_m, walls=()):
    blocker = MeshScene(mesh.vertices, mesh.faces)
    return TubeScene(mesh=SmoothMesh(blocker), walls=walls, waveform=WAVEFORM, tube_m=tube_m)


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, 20.0])
def test_dihedral_within_half_a_decibel_of_its_cross_section(angle_deg):
    # Two plates a wide and b high at a right angle; 2 a sin(45 degrees - angle) of their width
    # answers twice: sigma = 4 pi (w b)^2 / lambda^2 (Knott, Radar Cross Section, 2004).
    a, b, t, range_m = 0.04, 0.05, 0.002, 20.0
    plates = [
        trimesh.creation.box(bounds=[[0.0, -t, -b / 2], [a, 0.0, b / 2]]),
        trimesh.creation.box(bounds=[[-t, -t, -b / 2], [0.0, a, b / 2]]),
    ]
    mesh = trimesh.util.concatenate(plates)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 4, [0, 0, 1]))
    angle = np.deg2rad(angle_deg)
    eye = range_m * np.array([np.cos(angle), np.sin(angle), 0.0])
    tubes = second_bounce(tube_scene(mesh, 0.001), eye, blocks_of(eye))
    signal = tube_echo(tubes, eye[None], eye[None], WAVEFORM)[0]
    wavelengths = C / FREQUENCIES
    sigma = np.abs(signal) ** 2 * (4 * np.pi) ** 3 * range_m**4 / wavelengths**2
    wide = 2 * a * np.sin(np.pi / 4 - angle)
    error_db = 10 * np.log10(sigma * wavelengths**2 / (4 * np.pi * (wide * b) ** 2))
    assert np.abs(error_db).max() < 0.5


def test_derivatives_of_a_hit_are_those_between_neighbouring_rays():
    # Half of a hollow cylinder, axis z, seen from its axis' side.
    angles = np.linspace(np.pi / 2, 3 * np.pi / 2, 181)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) * 0.05
    vertices = np.concatenate([np.c_[ring, np.full(len(ring), z)] for z in (-0.03, 0.03)])
    i, n = np.arange(len(ring) - 1), len(ring)
    faces = np.concatenate([np.c_[i, i + 1, i + n], np.c_[i + 1, i + 1 + n, i + n]])
    scene = tube_scene(trimesh.Trimesh(vertices, faces, process=False), 0.001)
    eye, leg = np.array([0.4, 0.0, 0.0]), np.array([-1.0, 0.05, 0.03])
    turning = np.array([[[0.0, 1e-4, 0.0], [0.0, 0.0, 1e-4]]])
    directions = leg + np.concatenate([np.zeros((1, 3)), turning[0]])
    still, length = np.zeros((3, 2, 3)), np.linalg.norm(leg)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    own = turning / length - (turning @ directions[0])[..., None] * directions[0] / length
    hit = scene.mesh.meet(eye[None], directions[:1], still[:1], own)
    others = scene.mesh.meet(np.broadcast_to(eye, (3, 3)), directions, still, still)
    assert np.abs(hit.across[0] - (others.points[1:] - others.points[0])).max() < 3e-7
    turned = others.normals[1:] - others.normals[0]
    assert np.abs(turned).max() > 5e-4
    assert np.abs(hit.turns[0] - turned).max() < 0.03 * np.abs(turned).max()


def test_back_of_a_dielectric_sphere_is_focused_as_by_its_lens_matrix():
    # Refracted, reflected, refracted near the axis: rays at height y leave at the angle C y, and
    # the echo is that of a mirror of focal length 1 / C. Permittivity below 2: no glory ring.
    radius, permittivity, range_m = 0.03, 1.7, 20.0
    ball = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    eye = np.array([range_m, 0.0, 0.0])
    tubes = back_face(tube_scene(ball, 0.0007), eye, blocks_of(eye), (permittivity, 0.0))
    # What leaves at the sphere's rim echoes, too; here it is faded out.
    near = np.exp(-((np.linalg.norm(tubes.tx_points[:, 1:], axis=1) / 0.012) ** 4))
    tubes = replace(tubes, weights=tubes.weights * near)
    got = tube_echo(tubes, eye[None], eye[None], WAVEFORM)[0]
    n = np.sqrt(permittivity)
    lens = np.array([[1.0, 0.0], [-(n - 1) / radius, 1.0]])
    leg = np.array([[1.0, 2 * radius / n], [0.0, 1.0]])
    mirror = np.array([[1.0, 0.0], [-2 * n / radius, 1.0]])
    c = (lens @ leg @ mirror @ leg @ lens)[1, 0]
    r = (n - 1) / (n + 1)
    path = 2 * (range_m - radius) + 4 * n * radius
    wanted = r * (1 - r**2) / (2 * K * c * range_m**2) * np.exp(-1j * K * path)
    assert c < 0  # rays cross in between: the sign shows that folds are counted
    assert got / wanted == pytest.approx(np.ones(len(K)), abs=0.1)


def test_back_face_of_a_plate_echoes_at_its_apparent_depth():
    # Image of the antenna in the back face, seen through the front: r (1 - r^2) / 4 k (R + t / n).
    thickness, permittivity, loss = 0.02, 3.45, 0.01
    plate = trimesh.creation.box(bounds=[[-thickness, -0.15, -0.15], [0.0, 0.15, 0.15]])
    positions = np.array([[0.4, 0.0, 0.0], [0.4, 0.01, 0.0], [0.405, 0.0, 0.01]])
    eye = positions.mean(axis=0)
    tubes = back_face(tube_scene(plate, 0.0025), eye, blocks_of(positions), (permittivity, loss))
    got = tube_echo(tubes, positions, positions, WAVEFORM)
    n = np.sqrt(permittivity)
    r = (n - 1) / (n + 1)
    depth = positions[:, :1] + thickness / n
    k_middle = 2 * np.pi / WAVEFORM.center_wavelength_m
    lost = np.exp(-k_middle * n * loss * thickness)
    path = 2 * (positions[:, :1] + n * thickness)
    wanted = lost * r * (1 - r**2) / (4 * K * depth) * np.exp(-1j * K * path)
    # The plate's edges echo, too: 8 % of it at single frequencies.
    ratio = (got / wanted).mean(axis=1)
    assert np.abs(ratio) == pytest.approx(np.ones(3), abs=0.05)
    assert np.abs(np.angle(ratio)).max() < 0.2


def film_of(mesh, thickness_m, permittivity):
    plate = Wall(size_m=(0.1, 0.1, 0.1), thickness_m=thickness_m, permittivity=permittivity)
    return Film(plate=plate, loss_tangent=0.0, n_faces=len(mesh.faces))


def test_far_side_of_a_shell_echoes_as_a_film_behind_a_film():
    # Image of the antenna in the far film; both ways cross the near film.
    thickness, permittivity, apart = 0.0009, 2.6, 0.03
    box = trimesh.creation.box(bounds=[[-apart, -0.15, -0.15], [0.0, 0.15, 0.15]])
    positions = np.array([[0.4, 0.0, 0.0], [0.4, 0.01, 0.0], [0.405, 0.0, 0.01]])
    eye, film = positions.mean(axis=0), film_of(box, thickness, permittivity)
    tubes = behind_film(tube_scene(box, 0.0025), eye, blocks_of(positions), film)
    got = tube_echo(tubes, positions, positions, WAVEFORM)
    n = np.sqrt(permittivity)
    r = (1.0 - n) / (1.0 + n)
    both = slab_reflection(np.ones(1), film.plate, FREQUENCIES)[0]
    depth = positions[:, :1] + apart
    path = 2 * (depth + (n - 1) * thickness)
    wanted = both * (1 - r**2) ** 2 / (4 * K * depth) * np.exp(-1j * K * path)
    ratio = (got / wanted).mean(axis=1)
    assert np.abs(ratio) == pytest.approx(np.ones(3), abs=0.05)
    assert np.abs(np.angle(ratio)).max() < 0.2


def test_a_conductor_in_a_shell_echoes_as_without_it_but_for_two_crossings():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.02)
    ball.apply_translation([0.01, 0.0, 0.0])
    shell = trimesh.creation.icosphere(subdivisions=4, radius=0.05)
    both = trimesh.util.concatenate([shell, ball])
    eye, thickness, permittivity = np.array([0.5, 0.0, 0.0]), 0.0008, 2.4
    film = film_of(shell, thickness, permittivity)
    tubes = behind_film(tube_scene(both, 0.0007), eye, blocks_of(eye), film)
    # The others are of the shell's far side.
    near = tubes.path_m < 2 * 0.03
    tubes = replace(tubes, **{name: values[near] for name, values in vars(tubes).items()})
    got = tube_echo(tubes, eye[None], eye[None], WAVEFORM)[0]
    n = np.sqrt(permittivity)
    r = (1.0 - n) / (1.0 + n)
    mesh = trimesh.creation.icosphere(subdivisions=6, radius=0.02)
    mesh.apply_translation([0.01, 0.0, 0.0])
    normals, middles = mesh.face_normals, mesh.triangles_center
    lit = np.einsum("ij,ij->i", eye - middles, normals) > 0.0
    elements = SurfaceElements(
        points=middles,
        normals=normals,
        edges=mesh.triangles[:, :2] - middles[:, None],
        shape="triangle",
    )
    weights = (mesh.area_faces * lit)[None].astype(np.complex128)
    bare = physical_optics(elements, weights, blocks_of(eye), WAVEFORM)[0]
    wanted = bare * (1 - r**2) ** 2 * np.exp(-2j * K * (n - 1) * thickness)
    assert got / wanted == pytest.approx(np.ones(len(K)), abs=0.1)


def test_two_faces_of_a_slab_lack_only_the_inner_reflections_of_airys_formula():
    slab = Wall(size_m=(0.2, 0.2, 0.2), thickness_m=0.004, permittivity=1.6)
    cosine = np.cos(np.deg2rad([0.0, 20.0, 40.0, 60.0]))
    two = slab_reflection(cosine, slab, FREQUENCIES)
    # Transfer of the tangential fields through the layer (Born and Wolf, section 1.6.2), TE.
    inner = np.sqrt(1.6 - 1 + cosine**2)[:, None]
    c = cosine[:, None]
    phase = K * 0.004 * inner
    m11, m12, m21 = np.cos(phase), 1j / inner * np.sin(phase), 1j * inner * np.sin(phase)
    b, d = m11 + m12 * c, m21 + m11 * c
    airy = (c * b - d) / (c * b + d)
    r = (c - inner) / (c + inner)
    assert (np.abs(two - airy) < 2.1 * np.abs(r) ** 3).all()


def test_cross_walls_agrees_with_a_face_by_face_sum():
    walls = (
        Wall(size_m=(0.3, 0.28, 0.26), thickness_m=0.004, permittivity=1.6),
        Wall(size_m=(0.1, 0.1, 0.1), thickness_m=0.002, permittivity=2.5),
    )
    points = np.array([[0.02, 0.01, 0.0], [-0.12, 0.03, 0.01], [0.1, -0.1, 0.1], [-0.2, 0.0, 0.0]])
    position = np.array([0.5, 0.08, 0.03])
    transmission, excess_m = cross_walls(points, position, walls)
    for point, t, e in zip(points, transmission, excess_m, strict=True):
        both = [crossing(point, position, wall) for wall in walls]
        assert t == pytest.approx(np.prod([part[1] for part in both]), abs=1e-12)
        assert e == pytest.approx(sum(part[0] for part in both), abs=1e-12)


def test_multipath_is_the_path_via_the_wall_by_hand():
    box = Wall(size_m=(0.24, 0.22, 0.26), thickness_m=0.004, permittivity=1.6)
    point, normal = np.array([-0.05, 0.03, 0.01]), np.array([1.0, 0.9, 0.1])
    normal /= np.linalg.norm(normal)
    facet = SurfaceElements(points=point[None], normals=normal[None])
    far_away = trimesh.creation.box(extents=[0.001, 0.001, 0.001])
    far_away.apply_translation([0.0, -0.08, -0.08])
    scene = EchoScene(
        waveform=WAVEFORM,
        walls=(box,),
        blocker=MeshScene(far_away.vertices, far_away.faces),
        figure=Layer(elements=facet, areas=np.array([1e-6])),
    )
    tx, rx = np.array([0.28, 0.02, 0.03]), np.array([0.28, 0.025, 0.03])
    antennas = blocks_of(tx, rx)
    got = multipath_echo(facet, np.array([1e-6]), antennas, scene)[0]
    middle = 0.5 * (tx + rx)
    wanted, n_met = np.zeros(len(K), complex), 0
    for axis in range(3):
        for side in (-1.0, 1.0):
            plane = side * (0.5 * box.size_m[axis] - box.thickness_m)
            inward = -side * np.eye(3)[axis]
            if (middle[axis] - plane) * inward[axis] < 0:
                continue
            for near, far in ((tx, rx), (rx, tx)):
                image = far.copy()
                image[axis] = 2 * plane - image[axis]
                met = point + (plane - point[axis]) / (image - point)[axis] * (image - point)
                within = np.abs(met) < 0.5 * np.array(box.size_m) - 0.0039
                if (image - point) @ normal <= 0 or not within.all():
                    continue
                n_met += 1
                legs = [np.linalg.norm(v) for v in (near - point, met - point, far - met)]
                cosine = (far - met) @ inward / legs[2]
                inner = np.sqrt(0.6 + cosine**2)
                r = (cosine - inner) / (cosine + inner)
                mirror = r * (1 - (1 - r**2) * np.exp(-2j * K * box.thickness_m * inner))
                one, two = crossing(point, near, box), crossing(met + 1e-9 * inward, far, box)
                out = (met - point) / legs[1]
                lean = 0.5 * ((near - point) / legs[0] + out) @ normal
                path = sum(legs) + one[0] + two[0]
                wanted += (
                    -1j
                    / (4 * np.pi)
                    * 1e-6
                    * lean
                    * mirror
                    * one[1]
                    * two[1]
                    / (legs[0] * (legs[1] + legs[2]))
                    * np.exp(-1j * K * path)
                )
    assert n_met >= 2
    assert np.linalg.norm(got - wanted) < 0.02 * np.linalg.norm(wanted)
    direct = physical_optics(
        facet, np.array([[1e-6]], np.complex64), antennas, WAVEFORM, walls=(box,)
    )
    assert np.linalg.norm(got) > 0.05 * np.linalg.norm(direct)
