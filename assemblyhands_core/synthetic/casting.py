"""What every pixel of a camera sees of a mesh, through the true lens.

Of small faces, such as the thousands of hands: each pixel's ray is met with the faces whose image lies around that
pixel, which is many times faster than to look for each ray's face in a tree. Of large faces, such as those of
furniture: Embree looks for the faces of every second pixel along both axes, and the pixels between some that all see
the same face see it too. The tests of ray and face are exact.
"""

import numpy as np
from jaxtyping import Float32, Float64, Int32

from assemblyhands_core.geometry.cameras import Camera
from assemblyhands_core.synthetic.compiled import compiled
from assemblyhands_core.synthetic.lens_rays import LensRays
from assemblyhands_core.synthetic.surfaces import MISS, Hits, Surfaces

Vector = tuple[float, float, float]
Corners = tuple[int, int, int]  # rows of vertices
Plane = tuple[Vector, Vector, Vector, Vector]  # see `_plane`
_BOW = 0.15  # how far the image of an edge may bow, as a share of length² / focal: 0.08 in an equidistant fisheye
_MARGIN_PX = 0.02
_WIDE_PX = 6  # faces whose columns are worked out for each row
_CUT_MARGIN_PX = 12.0  # at most, for a face of which only a part is in the field and how long it is there is not known


def cast_at(
    camera: Camera, lens: LensRays, surfaces: Surfaces, distances_mm: Float32[np.ndarray, "height width"]
) -> tuple[Int32[np.ndarray, " pixel"], Hits]:
    """Find the pixels that see a mesh nearer than what they have seen so far, from outside.

    Args:
        camera: At its pose.
        lens: Its rays.
        surfaces: The mesh.
        distances_mm: Of what pixels have seen so far, along their rays; updated.

    Returns:
        Flat indices of the pixels, ascending, and what they hit.
    """
    vertices = camera.to_camera(surfaces.vertices_mm.astype(np.float64))
    faces = np.full(distances_mm.shape, MISS, dtype=np.int32)
    images = camera.project_camera(vertices)
    bow = _BOW / min(camera.fx_px, camera.fy_px)
    top, bottom = _meet(vertices, images, surfaces.faces, bow, lens.rays, distances_mm, faces)
    seen = np.flatnonzero(faces[top:bottom] != MISS)
    pixels = (seen + top * camera.width_px).astype(np.int32)
    hit = faces.ravel()[pixels]
    return pixels, Hits(hit, *_meetings(vertices, surfaces.faces, lens.rays.reshape(-1, 3), pixels, hit))


def cast_all(camera: Camera, lens: LensRays, surfaces: Surfaces) -> Hits:
    """Find what all pixels see of a mesh; of what is smaller than two pixels some may be missed.

    Args:
        camera: At its pose.
        lens: Its rays.
        surfaces: The mesh.
    """
    shape, center_mm = lens.rays.shape[:2], camera.center_world_mm.astype(np.float32)
    hits = Hits.nothing(shape[0] * shape[1])
    second = np.arange(shape[0] * shape[1], dtype=np.int32).reshape(shape)[::2, ::2].ravel()
    hits.put(second, surfaces.first_hits(center_mm, lens.world(camera, second)))
    between, agreed, others = _between(hits.faces.reshape(shape))
    vertices = camera.to_camera(surfaces.vertices_mm.astype(np.float64))
    met = _meetings(vertices, surfaces.faces, lens.rays.reshape(-1, 3), between, agreed)
    hits.put(between, Hits(agreed, *met))
    hits.put(others, surfaces.first_hits(center_mm, lens.world(camera, others)))
    return hits


@compiled
def _between(
    faces: Int32[np.ndarray, "height width"],
) -> tuple[Int32[np.ndarray, " between"], Int32[np.ndarray, " between"], Int32[np.ndarray, " other"]]:
    """Return the pixels around which all that were asked see one face, that face, and the rest not asked yet.

    Those that see nothing are in neither list if those around them see nothing.
    """
    height, width = faces.shape
    between, others = np.empty(faces.size, np.int32), np.empty(faces.size, np.int32)
    agreed = np.empty(faces.size, np.int32)
    num_between, num_others = 0, 0
    for y in range(height):
        top, bottom = y - (y & 1), y + (y & 1)
        for x in range(1 - (y & 1), width, 2 - (y & 1)):
            left, right = x - (x & 1), x + (x & 1)
            if bottom < height and right < width:
                face = faces[top, left]
                if face == faces[top, right] == faces[bottom, left] == faces[bottom, right]:
                    if face != MISS:
                        between[num_between], agreed[num_between] = y * width + x, face
                        num_between += 1
                    continue
            others[num_others] = y * width + x
            num_others += 1
    return between[:num_between], agreed[:num_between], others[:num_others]


@compiled
def _meet(
    vertices: Float64[np.ndarray, "vertex 3"],
    images: Float64[np.ndarray, "vertex 2"],
    faces: Int32[np.ndarray, "face 3"],
    bow: float,
    rays: Float32[np.ndarray, "height width 3"],
    distances: Float32[np.ndarray, "height width"],
    seen: Int32[np.ndarray, "height width"],
) -> tuple[int, int]:
    """Keep the nearest face of every pixel; return the rows between which there are any."""
    height, width = distances.shape
    first_row, last_row = height, -1
    for face in range(len(faces)):
        corners = (faces[face, 0], faces[face, 1], faces[face, 2])
        volume = _volume(vertices, corners)
        if not volume < 0:
            continue
        left, top, right, bottom, missing = _image_box(vertices, images, corners, width, height)
        if missing == 3:
            continue
        wide, high = min(right - left, 1.0 * width), min(bottom - top, 1.0 * height)
        margin = _MARGIN_PX + min((wide * wide + high * high) * bow, _CUT_MARGIN_PX if missing else np.inf)
        x0, x1 = int(np.ceil(max(left - margin, 0.0))), int(min(right + margin, width - 1.0))
        y0, y1 = int(np.ceil(max(top - margin, 0.0))), int(min(bottom + margin, height - 1.0))
        if x1 < x0 or y1 < y0:
            continue
        first_row, last_row = min(first_row, y0), max(last_row, y1)
        plane = _plane(vertices, corners)
        is_wide = x1 - x0 >= _WIDE_PX and not missing
        for y in range(y0, y1 + 1):
            start, end = _row_range(images, corners, y, margin, x0, x1) if is_wide else (x0, x1)
            for x in range(start, end + 1):
                distance = _distance(rays[y, x, 0], rays[y, x, 1], rays[y, x, 2], plane, volume)
                if distance < distances[y, x]:
                    distances[y, x] = distance
                    seen[y, x] = face
    return first_row, last_row + 1


@compiled
def _volume(vertices: Float64[np.ndarray, "vertex 3"], corners: Corners) -> float:
    """Return det(a b c), negative for a face a b c seen from outside."""
    p, q, r = corners
    u = _cross(vertices[q, 0], vertices[q, 1], vertices[q, 2], vertices[r, 0], vertices[r, 1], vertices[r, 2])
    volume: float = vertices[p, 0] * u[0] + vertices[p, 1] * u[1] + vertices[p, 2] * u[2]
    return volume


@compiled
def _plane(vertices: Float64[np.ndarray, "vertex 3"], corners: Corners) -> Plane:
    """Return b×c, c×a, a×b and the normal (b-a)×(c-a) of a face a b c."""
    p, q, r = corners
    ax, ay, az = vertices[p, 0], vertices[p, 1], vertices[p, 2]
    bx, by, bz = vertices[q, 0], vertices[q, 1], vertices[q, 2]
    cx, cy, cz = vertices[r, 0], vertices[r, 1], vertices[r, 2]
    u, v, w = _cross(bx, by, bz, cx, cy, cz), _cross(cx, cy, cz, ax, ay, az), _cross(ax, ay, az, bx, by, bz)
    return u, v, w, _cross(bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az)


@compiled
def _cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> Vector:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@compiled
def _distance(dx: float, dy: float, dz: float, plane: Plane, volume: float) -> float:
    """Return how far along a ray it meets a face from outside, infinity where it does not.

    A ray d from the camera's centre meets the face a b c inside if d·(b×c), d·(c×a) and d·(a×b) have the sign of
    det(a b c). These are equal, up to the sign, for both faces at an edge, so no ray slips through between them. The
    distance is det(a b c) / d·n with the normal n.
    """
    u, v, w, n = plane
    if dx * u[0] + dy * u[1] + dz * u[2] > 0 or dx * v[0] + dy * v[1] + dz * v[2] > 0:
        return np.inf
    slope = dx * n[0] + dy * n[1] + dz * n[2]
    return volume / slope if dx * w[0] + dy * w[1] + dz * w[2] <= 0 and slope < 0 else np.inf


@compiled
def _image_box(
    vertices: Float64[np.ndarray, "vertex 3"],
    images: Float64[np.ndarray, "vertex 2"],
    corners: Corners,
    width: int,
    height: int,
) -> tuple[float, float, float, float, int]:
    """Return left, top, right and bottom of a face's corners in the picture, and how many are out of the field.

    One that is lies in its direction from the middle, but outside the picture.
    """
    left, top, right, bottom, missing = np.inf, np.inf, -np.inf, -np.inf, 0
    for corner in corners:
        x, y = images[corner, 0], images[corner, 1]
        if np.isnan(x):
            missing += 1
            x, y = vertices[corner, 0], vertices[corner, 1]
            length = max(np.sqrt(x * x + y * y), 1e-9)
            for radius in (0.5 * min(width, height), 2.0 * max(width, height)):
                u, v = 0.5 * width + radius * x / length, 0.5 * height + radius * y / length
                left, right, top, bottom = min(left, u), max(right, u), min(top, v), max(bottom, v)
        else:
            left, right, top, bottom = min(left, x), max(right, x), min(top, y), max(bottom, y)
    return left, top, right, bottom, missing


@compiled
def _row_range(
    images: Float64[np.ndarray, "vertex 2"], corners: Corners, y: int, margin: float, x0: int, x1: int
) -> tuple[int, int]:
    """Return between which columns of x0 to x1 a face lies in a row of the picture, or within a margin of it."""
    left, right = 1e9, 0.0
    for edge in range(3):
        a, b = corners[edge], corners[(edge + 1) % 3]
        if images[a, 1] > images[b, 1]:
            a, b = b, a
        top, bottom = max(images[a, 1], y - margin), min(images[b, 1], y + margin)
        if top > bottom:
            continue
        slope = (images[b, 0] - images[a, 0]) / max(images[b, 1] - images[a, 1], 1e-9)
        upper = images[a, 0] + (top - images[a, 1]) * slope
        lower = images[a, 0] + (bottom - images[a, 1]) * slope
        left, right = min(left, upper, lower), max(right, upper, lower)
    return max(x0, int(np.ceil(left - margin))), min(x1, int(right + margin))


@compiled
def _meetings(
    vertices: Float64[np.ndarray, "vertex 3"],
    faces: Int32[np.ndarray, "face 3"],
    rays: Float32[np.ndarray, "pixel 3"],
    pixels: Int32[np.ndarray, " hit"],
    hit: Int32[np.ndarray, " hit"],
) -> tuple[Float32[np.ndarray, "hit 2"], Float32[np.ndarray, " hit"]]:
    """Return the barycentric weights of the second and third corner, and the distances."""
    weights, distances = np.empty((len(pixels), 2), np.float32), np.empty(len(pixels), np.float32)
    for i in range(len(pixels)):
        corners = (faces[hit[i], 0], faces[hit[i], 1], faces[hit[i], 2])
        of_u, of_v, of_w, _ = _plane(vertices, corners)
        dx, dy, dz = rays[pixels[i], 0], rays[pixels[i], 1], rays[pixels[i], 2]
        u = dx * of_u[0] + dy * of_u[1] + dz * of_u[2]
        v = dx * of_v[0] + dy * of_v[1] + dz * of_v[2]
        w = dx * of_w[0] + dy * of_w[1] + dz * of_w[2]
        weights[i, 0], weights[i, 1] = v / (u + v + w), w / (u + v + w)
        distances[i] = _volume(vertices, corners) / (u + v + w)
    return weights, distances
