"""A surface moved along its normals to where the photos that see it agree."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.linalg import cg
from scipy.spatial import KDTree
from torch.nn.functional import grid_sample, normalize

from geraf2._types import Bools, Floats
from geraf2.apps.photos.config import AgreementRound
from geraf2.apps.photos.formats.masks import close_cracks
from geraf2.apps.photos.grid_smoothing import binomial_blur, close_body, quick_redistance
from geraf2.fields import SdfGrid
from geraf2.geometry.transforms import apply_rigid
from geraf2.geometry.triangles import directed_edges
from geraf2.io.mesh import TriangleMesh
from geraf2.ops import sdf_grid
from geraf2.ops.visibility import MeshScene
from geraf2.scene import Grid
from geraf2.scene.photos import Camera, PhotoSet, bin_pixels
from geraf2.surfaces.isosurface import extract_surface

_MIN_COSINE = 0.35
"""Least cosine of the angle between normal and camera of a compared photo, 70 degrees."""
_MAX_VIEWS = 8
"""Photos compared at a vertex, those that see it most frontally."""
_MIN_VIEWS = 3
"""Least photos of a comparison: three give three pairs; with two, any stripe matches somewhere."""
_PATCH_NODES = 9
"""Samples along a side of the square that is compared."""
_LARGEST_PATCH = 0.25
"""Largest side of the square over the longest side of the grid."""
_LOST_OVERLAP = 0.08
"""Largest loss of overlap with the silhouettes; more means that a thin part was pierced."""
_OVERLAP_PX = 160
"""Width of the pictures in which the overlap is counted."""
_MIN_SHARE = 0.6
"""Share of a square that must lie within picture and silhouette."""
_NOISE = 0.006
"""Brightness of noise in each sample, 1 is white: a square with less texture agrees with none."""
_LUMA = (0.299, 0.587, 0.114)
_NORMAL_PASSES = 6
"""Passes of the binomial filter before normals are computed."""
_LIFT_VOXELS = 1.5
"""Distance from the surface at which the ray to a camera begins."""
_CHUNK = 1 << 21
"""Samples of one photo that are drawn at once: 8 MB an array."""
_SMOOTHNESS = 0.5
"""Weight of the graph Laplacian over that of full agreement."""
_IDLE = 5e-3
"""Weight that holds vertices without evidence."""
_COUPLINGS = (0.0, 0.005, 0.02, 0.06, 0.15, 0.4, 1.0)
"""Weight of ((choice - smooth) / step)^2 against 1 - agreement, in each round."""


class _Vertices(NamedTuple):
    """Vertices of a surface with their axes, (n, 3) each."""

    centers: torch.Tensor
    normals: torch.Tensor
    first: torch.Tensor
    second: torch.Tensor


class _View(NamedTuple):
    """A photo without distortion, ready to be sampled."""

    projection: torch.Tensor
    """(3, 4), to coordinates from -1 to 1."""
    image: torch.Tensor
    """Brightness times silhouette, and silhouette, (1, 2, height, width)."""
    camera: Camera


def _prepared(photos: PhotoSet, factor: int) -> list[_View]:
    """Brightness and silhouette of each photo, without lens distortion."""
    views = []
    for index, camera in enumerate(photos.cameras):
        image = bin_pixels(photos.images[index], factor) @ np.asarray(_LUMA) / 255.0
        smaller = camera.join_pixels(factor)
        mask = np.ones(image.shape)
        if photos.masks is not None:
            mask = bin_pixels(close_cracks(photos.masks[index]), factor)
            mask = (mask > 0.99).astype(np.float64)
        both = np.stack([image * mask, mask])
        if any(camera.distortion):
            both = _undistorted(both, smaller)
        to_camera = np.linalg.inv(smaller.camera_to_world)[:3]
        scale = np.array(
            [[2.0 / smaller.width, 0.0, -1.0], [0.0, 2.0 / smaller.height, -1.0], [0.0, 0.0, 1.0]]
        )
        projection = scale @ smaller.intrinsics @ to_camera
        views.append(
            _View(
                torch.from_numpy(projection).to(torch.float32),
                torch.from_numpy(both[None]).to(torch.float32),
                smaller,
            )
        )
    return views


def _undistorted(channels: Floats, camera: Camera) -> Floats:
    """Channels (n, height, width) as a pinhole camera of the same intrinsics would show them."""
    pixels = camera.pixel_centers()
    ones = np.ones((pixels.shape[0], 1))
    local = np.linalg.solve(camera.intrinsics, np.concatenate([pixels, ones], axis=1).T).T
    world = apply_rigid(camera.camera_to_world, local)
    vertices = camera.project(world)[:, ::-1].T - 0.5
    return np.stack(
        [
            ndimage.map_coordinates(channel, vertices, order=1).reshape(channel.shape)
            for channel in channels
        ]
    )


def refine_by_agreement(
    values: NDArray[np.float32],
    grid: Grid,
    photos: PhotoSet,
    rounds: tuple[AgreementRound, ...],
    footprint_m: float,
) -> NDArray[np.float32]:
    """Signed distance whose zero level has moved to where the photos agree.

    At each vertex of the zero level a square in its tangent plane is moved along the normal and
    projected into the photos that see it. Agreement A is the mean over all pairs of photos of the
    normalised cross correlation of its brightness. The displacement u minimises

        sum_v 1 - A_v(u_v) + smoothness,

    by choosing the best position at each vertex and smoothing the choices in turns. Rounds whose
    squares would be larger than a quarter of the grid are skipped; one after which the surface
    fits the silhouettes worse is undone, and ends the search. Plane sweeps along normals: Collins
    1996; coupling of choice and smoothing: Newcombe et al., DTAM, 2011.

    values, grid: signed distance at the grid's nodes, grid.shape [m].
    rounds: one after the other, from coarse to fine.
    footprint_m: size of a pixel on the surface [m].
    """
    largest = _LARGEST_PATCH * grid.spacing_m * max(grid.shape)
    overlap = silhouette_overlap(values, grid, photos)
    for search in rounds:
        if (_PATCH_NODES - 1) * search.node_px * footprint_m > largest:
            continue
        views = _prepared(photos, search.factor)
        moved = _one_round(values, grid, views, search, footprint_m)
        before, overlap = overlap, silhouette_overlap(moved, grid, photos)
        if before - overlap > _LOST_OVERLAP:
            break  # a finer search would begin at the wrong position
        values = moved
    return values


def silhouette_overlap(values: NDArray[np.float32], grid: Grid, photos: PhotoSet) -> float:
    """Intersection over union of surface and silhouettes in all photos; 1 without silhouettes."""
    if photos.masks is None:
        return 1.0
    mesh = _zero_level(values, grid)
    if mesh.faces.shape[0] == 0:
        return 0.0
    scene, common, either = MeshScene(mesh.vertices, mesh.faces), 0, 0
    for camera, mask in zip(photos.cameras, photos.masks, strict=True):
        factor = max(1, round(camera.width / _OVERLAP_PX))
        smaller = camera.join_pixels(factor)
        _, face = scene.closest_hit(*smaller.rays(smaller.pixel_centers()))
        solid = (face >= 0).reshape(smaller.height, smaller.width)
        shown = bin_pixels(close_cracks(mask), factor) >= 0.5
        common += int((solid & shown).sum())
        either += int((solid | shown).sum())
    return common / max(either, 1)


def _zero_level(values: NDArray[np.float32], grid: Grid) -> TriangleMesh:
    return extract_surface(SdfGrid(grid=grid, values=close_body(values, grid.spacing_m)))


def _one_round(
    values: NDArray[np.float32],
    grid: Grid,
    views: list[_View],
    search: AgreementRound,
    footprint_m: float,
) -> NDArray[np.float32]:
    mesh = _zero_level(values, grid)
    if mesh.faces.shape[0] == 0:
        return values
    vertices = _axes(mesh, values, grid)
    chosen = _choose_views(mesh, vertices, views, grid.spacing_m)
    n_steps = int(np.ceil(search.reach_px / search.step_px))
    steps = np.arange(-n_steps, n_steps + 1, dtype=np.float64)
    offsets = footprint_m * search.step_px * steps
    agreement = _agreement(vertices, chosen, views, offsets, footprint_m * search.node_px)
    moved = _smooth_choice(agreement, offsets, _laplacian(mesh))
    return quick_redistance(_displaced(values, grid, mesh, moved), grid.spacing_m)


def _axes(mesh: TriangleMesh, values: NDArray[np.float32], grid: Grid) -> _Vertices:
    smooth = binomial_blur(torch.from_numpy(values), _NORMAL_PASSES).numpy()
    gradient = sdf_grid(smooth, grid, mesh.vertices).gradient
    normals = normalize(torch.as_tensor(np.asarray(gradient)).to(torch.float32), dim=1)
    # any direction other than the normal
    axis = torch.nn.functional.one_hot(normals.abs().argmin(dim=1), 3).to(torch.float32)
    first = normalize(torch.linalg.cross(normals, axis), dim=1)
    return _Vertices(
        torch.from_numpy(mesh.vertices).to(torch.float32),
        normals,
        first,
        torch.linalg.cross(normals, first),
    )


def _choose_views(
    mesh: TriangleMesh, vertices: _Vertices, views: list[_View], spacing_m: float
) -> Bools:
    """Whether each photo is compared at each vertex, (n_views, n)."""
    scene = MeshScene(mesh.vertices, mesh.faces)
    normals = vertices.normals.numpy().astype(np.float64)
    starts = mesh.vertices + _LIFT_VOXELS * spacing_m * normals
    cosines = np.zeros((len(views), mesh.vertices.shape[0]))
    for row, view in zip(cosines, views, strict=True):
        towards = view.camera.position - mesh.vertices
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        cosine = (normals * towards).sum(axis=1)
        ask = np.nonzero(cosine > _MIN_COSINE)[0]
        ends = np.broadcast_to(view.camera.position, (ask.size, 3))
        row[ask] = cosine[ask] * ~scene.occluded(starts[ask], ends)
    n_kept = min(_MAX_VIEWS, len(views))
    least = np.partition(cosines, -n_kept, axis=0)[-n_kept]
    chosen = (cosines > 0.0) & (cosines >= least)
    return np.asarray(chosen & (chosen.sum(axis=0) >= _MIN_VIEWS))


@torch.no_grad()
def _agreement(
    vertices: _Vertices, chosen: Bools, views: list[_View], offsets: Floats, node_m: float
) -> NDArray[np.float32]:
    """Mean correlation of all pairs of photos at each position and offset, (n, n_offsets)."""
    n, n_offsets = vertices.centers.shape[0], offsets.size
    agreement = torch.zeros((n, n_offsets))
    step = torch.arange(_PATCH_NODES) - (_PATCH_NODES - 1) / 2.0
    across, along = (
        part.reshape(-1) * node_m for part in torch.meshgrid(step, step, indexing="ij")
    )
    shifts = torch.from_numpy(offsets).to(torch.float32)
    wanted = torch.from_numpy(chosen)
    rows = max(1, _CHUNK // (n_offsets * across.shape[0]))
    for part in torch.split(torch.nonzero(wanted.any(dim=0))[:, 0], rows):
        total = torch.zeros((part.shape[0], n_offsets, across.shape[0]))
        norm = torch.zeros((part.shape[0], n_offsets))
        for view, uses in zip(views, wanted, strict=True):
            here = torch.nonzero(uses[part])[:, 0]
            if here.shape[0] == 0:
                continue
            turned, moved = view.projection[:, :3], view.projection[:, 3]
            row = part[here]
            middle = (vertices.centers[row] @ turned.T + moved)[:, None, None]
            normal = (vertices.normals[row] @ turned.T)[:, None, None] * shifts[:, None, None]
            square = (vertices.first[row] @ turned.T)[:, None, None] * across[:, None] + (
                vertices.second[row] @ turned.T
            )[:, None, None] * along[:, None]
            seen = _sampled(view.image, (middle + normal) + square)
            total.index_add_(0, here, seen)
            norm.index_add_(0, here, (seen * seen).sum(dim=2))
        pairs = wanted[:, part].sum(dim=0).to(torch.float32)[:, None]
        agreement[part] = ((total * total).sum(dim=2) - norm) / (pairs * (pairs - 1.0))
    return agreement.numpy()


def _sampled(image: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
    """Brightness at (n, n_offsets, m, 3) as unit vectors over the last axis; zero if unknown."""
    n, n_offsets, m, _ = at.shape
    plane = (at[..., :2] / at[..., 2:].clamp(min=1e-9)).reshape(1, n * n_offsets, m, 2)
    found = grid_sample(image, plane, align_corners=False).reshape(2, n, n_offsets, m)
    known = (found[1] > 0.99).to(torch.float32)
    count = known.sum(dim=2, keepdim=True)
    bright = found[0] * known
    centred = (bright - bright.sum(dim=2, keepdim=True) / count.clamp(min=1.0)) * known
    length = ((centred * centred).sum(dim=2, keepdim=True) + count * _NOISE**2).sqrt()
    return centred / length.clamp(min=1e-9) * (count >= _MIN_SHARE * m)


def _laplacian(mesh: TriangleMesh) -> csr_matrix:
    """Graph Laplacian of the vertices over their number of neighbours."""
    n = mesh.vertices.shape[0]
    edges = directed_edges(mesh.faces)
    both = np.concatenate([edges, edges[:, ::-1]])
    matrix = coo_matrix((np.ones(both.shape[0]), (both[:, 0], both[:, 1])), shape=(n, n)).tocsr()
    matrix.data[:] = 1.0
    return diags(np.asarray(matrix.sum(axis=1)).ravel()) - matrix


def _smooth_choice(
    agreement: NDArray[np.float32], offsets: Floats, laplacian: csr_matrix
) -> Floats:
    """Displacement of each vertex [m]."""
    still = float(offsets.size // 2)
    vertices = np.arange(offsets.size)
    # distinctness of the best position
    weight = np.clip(agreement.max(axis=1) - np.median(agreement, axis=1), 0.0, 1.0)
    weight = weight.astype(np.float64)
    system = diags(weight + _IDLE) + _SMOOTHNESS * laplacian
    cost = 1.0 - agreement.astype(np.float64)
    smooth = np.full(agreement.shape[0], still)
    for coupling in _COUPLINGS:
        choice = _lowest(cost + coupling * np.square(vertices - smooth[:, None]))
        smooth, _ = cg(system, weight * choice + _IDLE * still, x0=smooth, rtol=1e-4, maxiter=200)
    return (smooth - still) * float(offsets[1] - offsets[0])


def _lowest(cost: Floats) -> Floats:
    """Position of the minimum of each row, by the parabola through its neighbours."""
    best = np.clip(cost.argmin(axis=1), 1, cost.shape[1] - 2)
    rows = np.arange(cost.shape[0])
    before, here, after = (cost[rows, best + k] for k in (-1, 0, 1))
    bend = np.maximum(before - 2.0 * here + after, 1e-9)
    return np.asarray(best + np.clip(0.5 * (before - after) / bend, -1.0, 1.0))


def _displaced(
    values: NDArray[np.float32], grid: Grid, mesh: TriangleMesh, moved: Floats
) -> NDArray[np.float32]:
    """Signed distance after its zero level has moved outwards by `moved` at each vertex [m]."""
    reach = np.abs(moved).max() + 4.0 * grid.spacing_m
    near = np.abs(values) < reach
    distance, nearest = KDTree(mesh.vertices).query(grid.points()[near.ravel()], k=4)
    share = 1.0 / np.maximum(distance, 0.1 * grid.spacing_m)
    change = (share * moved[nearest]).sum(axis=1) / share.sum(axis=1)
    found = values.copy()
    found[near] -= change.astype(np.float32)
    return found
