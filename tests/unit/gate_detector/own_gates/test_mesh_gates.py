"""Gates of triangles: their opening is found, whatever the unit and the axes, and files without one are refused."""

import numpy as np
import pytest
import trimesh
from gate_meshes import DEPTH, INNER, box, frame, turned
from PIL import Image

from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.images.own_gates import files, mesh, opening
from swift_sim_bridge.gate_detector.images.own_gates.raster import rasterise


def save(path, gate):
    gate.export(str(path))
    return path


def bounds(gate) -> np.ndarray:
    """Return the lowest and highest corner (2, 3) of a gate's triangles."""
    points = gate.mesh.triangles.reshape(-1, 3)
    return np.stack([points.min(axis=0), points.max(axis=0)])


def test_the_opening_of_a_frame_is_where_it_was_planted(tmp_path):
    moved = frame(inner=(1.8, 1.5)).apply_translation((7.0, -3.0, 2.0))
    found = opening.read(save(tmp_path / "a.obj", moved))
    assert found.width == pytest.approx(1.8 / 1.5, abs=1e-6)
    assert found.depth == pytest.approx(DEPTH / 1.5, abs=1e-6)
    wide, tall = (1.8 / 2 + 0.3) / 1.5, (1.5 / 2 + 0.3) / 1.5
    np.testing.assert_allclose(bounds(found), [[-wide, -tall, 0.0], [wide, tall, DEPTH / 1.5]], atol=1e-6)


@pytest.mark.parametrize("name", ["a.stl", "a.ply", "a.obj"])
def test_the_unit_and_the_direction_of_the_passage_change_nothing(tmp_path, name):
    expected = opening.read(save(tmp_path / "expected.obj", frame()))
    millimetres = turned(frame(), 90.0, (0, 0, 1)).apply_scale(1000.0)
    found = opening.read(save(tmp_path / name, millimetres))
    np.testing.assert_allclose(bounds(found), bounds(expected), atol=1e-6)
    np.testing.assert_allclose(found.corners(), expected.corners(), atol=1e-6)
    assert (found.silhouette == expected.silhouette).mean() > 0.99


def test_gltf_has_its_y_axis_up(tmp_path):
    legs = [box((x - 0.05, -0.05, -2.5), (x + 0.05, 0.05, -1.05)) for x in (-0.9, 0.9)]
    standing = trimesh.util.concatenate([frame(), *legs])
    expected = opening.read(save(tmp_path / "a.obj", standing))
    found = opening.read(save(tmp_path / "a.glb", turned(standing, -90.0, (1, 0, 0))))
    np.testing.assert_allclose(bounds(found), bounds(expected), atol=1e-6)
    assert bounds(found)[1, 1] == pytest.approx(2.5 / INNER, abs=1e-6)  # down is positive


def test_a_gate_seen_from_behind_is_mirrored_and_has_its_rim_in_front(tmp_path):
    visor = box((-1.05, 0.1, 0.75), (-0.75, 0.6, 1.05))  # before the upper left corner, seen from +y the right one
    found = opening.read(save(tmp_path / "a.obj", trimesh.util.concatenate([frame(), visor])))
    assert found.depth == pytest.approx(DEPTH / INNER, abs=1e-6)
    back = found.turned()
    assert bounds(back)[0, 2] == pytest.approx(-0.5 / INNER, abs=1e-6)
    np.testing.assert_allclose(back.turned().mesh.triangles, found.mesh.triangles, atol=1e-12)


def test_the_holes_of_a_truss_are_no_openings(tmp_path):
    bars = [
        box((x - 0.02, y - 0.02, -1.05), (x + 0.02, y + 0.02, 1.05))
        for x in (-1.03, 1.03, -0.77, 0.77)
        for y in (0, 0.2)
    ]
    beams = [turned(bar, 90.0, (0, 1, 0)) for bar in bars]
    rungs = [
        box((x - 0.15, -0.02, z), (x + 0.15, 0.02, z + 0.03)) for x in (-0.9, 0.9) for z in np.linspace(-0.9, 0.9, 9)
    ]
    rungs += [turned(rung, 90.0, (0, 1, 0)) for rung in rungs]
    found = opening.read(save(tmp_path / "a.stl", trimesh.util.concatenate([*bars, *beams, *rungs])))
    assert found.width == pytest.approx(1.0, abs=1e-3)
    assert bounds(found)[1, 0] == pytest.approx(1.05 / 1.5, abs=0.01)


def test_a_slit_between_the_parts_of_a_frame_does_not_open_it(tmp_path):
    raised = frame()
    raised.vertices[16:24, 2] += 0.003  # the upper box
    found = opening.read(save(tmp_path / "a.obj", raised))
    assert found.width == pytest.approx(1.5 / 1.503, abs=1e-6)


def test_colours_of_faces_and_textures_are_read(tmp_path):
    painted = frame()
    painted.visual.face_colors = np.tile([255, 128, 0, 255], (len(painted.faces), 1))
    found = mesh.read(save(tmp_path / "a.ply", painted))
    assert found.coloured.all() and (found.colours == (0, 128, 255)).all()
    assert not mesh.read(save(tmp_path / "a.stl", frame())).coloured.any()

    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
    halves = Image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]] * 2, np.uint8))  # red left, blue right
    look = trimesh.visual.TextureVisuals(uv=corners[:, :2], image=halves)
    plate = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], visual=look, process=False)
    found = mesh.read(save(tmp_path / "a.glb", plate))
    (texture,) = found.textures
    assert (texture[:, 0] == (0, 0, 255)).all() and (texture[:, 1] == (255, 0, 0)).all()
    np.testing.assert_allclose(found.texels[0, :, 0], [-0.5, 1.5, 1.5])
    np.testing.assert_allclose(found.texels[0, :, 1], [1.5, 1.5, -0.5])  # v = 0 is the lower edge


def test_parts_of_a_scene_keep_their_places_colours_and_textures(tmp_path):
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0)], float)
    material = trimesh.visual.material.PBRMaterial
    materials = [material(baseColorFactor=[0, 0, 255, 255]), material()]
    pictures = [Image.new("RGB", (4, 4), name) for name in ("red", "lime")]
    looks = [trimesh.visual.TextureVisuals(uv=corners[:, :2], image=picture) for picture in pictures]
    looks += [trimesh.visual.TextureVisuals(material=one) for one in materials]  # the last has no colour
    scene = trimesh.Scene()
    for k, look in enumerate(looks):
        moved = trimesh.transformations.translation_matrix((10.0 * k, 0, 0))
        scene.add_geometry(trimesh.Trimesh(corners, [(0, 1, 2)], visual=look, process=False), transform=moved)
    found = mesh.read(save(tmp_path / "a.glb", scene))
    order = np.argsort(found.triangles[:, 0, 0])
    np.testing.assert_allclose(found.triangles[order, 0, 0], [0.0, 10.0, 20.0, 30.0])
    seen = [tuple(found.textures[k][0, 0]) if k >= 0 else tuple(found.colours[n]) for n, k in enumerate(found.texture)]
    assert [seen[n] for n in order[:3]] == [(0, 0, 255), (0, 255, 0), (255, 0, 0)]
    assert found.coloured[order].tolist() == [True, True, True, False]


def test_a_texture_beside_its_mesh_is_no_picture_of_a_gate(tmp_path):
    look = trimesh.visual.TextureVisuals(uv=np.zeros((len(frame().vertices), 2)), image=Image.new("RGB", (4, 4), "red"))
    textured = frame()
    textured.visual = look
    save(tmp_path / "a.obj", textured)
    assert list(tmp_path.glob("*.png"))
    (found,) = files.read(tmp_path, bar=0.2)
    assert isinstance(found, opening.MeshGate) and len(found.mesh.textures) == 1


def test_the_nearest_of_two_triangles_that_cross_is_seen():
    triangle = np.array([(0.0, 0.0), (40.0, 0.0), (0.0, 40.0)])
    seen = rasterise(np.stack([triangle, triangle]), np.array([[1.0, 3.0, 1.0], [2.0, 2.0, 2.0]]), (41, 41))
    assert (seen.nearest[:, 21:][seen.nearest[:, 21:] >= 0] == 0).all()
    assert (seen.nearest[:20, :20] == 1).all() and seen.nearest[40, 40] == -1
    np.testing.assert_allclose(seen.nearness[0, 40], 3.0, atol=1e-5)
    np.testing.assert_allclose(seen.weights(np.array([0]), np.array([30])), [[0.1, 0.9, 0.0]], atol=1e-6)


def broken(kind: str):
    """Return a mesh that is no gate."""
    if kind == "plate":
        return box((-1, -0.1, -1), (1, 0.1, 1))
    if kind == "lying":
        return turned(frame(), 90.0, (1, 0, 0))
    if kind == "long":
        return frame(inner=(3.0, 1.5))
    if kind == "round":
        return turned(trimesh.creation.annulus(0.75, 1.0, 0.1), 90.0, (1, 0, 0))
    if kind == "stacked":
        return trimesh.util.concatenate([frame(), frame().apply_translation((0, 0, 1.8))])
    if kind == "nan":
        gate = frame()
        gate.vertices[3, 1] = np.nan
        return gate
    return trimesh.util.concatenate([frame()] * 1100) if kind == "fine" else frame()


@pytest.mark.parametrize(
    "kind, sentence",
    [
        ("plate", r"has no opening, seen along its horizontal axes; a gate stands upright with z up"),
        ("lying", r"has no opening, seen along its horizontal axes"),
        ("long", r"has an opening that is far from square: 2.00 times as wide as high, 100 % of it within its corners"),
        (
            "round",
            r"has an opening that is far from square: \d.\d\d times as wide as high, 6\d % of it within its corners",
        ),
        ("stacked", r"has two openings of similar size, of which one may be that of its stand; give a mesh with one"),
        ("nan", r"has a corner that is not a number; repair the mesh"),
        ("fine", r"has \d+ triangles, more than 50000; decimate it"),
    ],
)
def test_a_mesh_that_is_no_gate_meets_a_sentence(tmp_path, kind, sentence):
    save(tmp_path / "a.obj", broken(kind))
    with pytest.raises(UsageError, match=rf"a\.obj {sentence}"):
        files.read(tmp_path, bar=0.2)


@pytest.mark.parametrize("name", ["a.glb", "a.gltf", "a.ply", "a.stl"])
def test_a_file_that_is_no_mesh_meets_a_sentence(tmp_path, name):
    (tmp_path / name).write_bytes(b"no mesh at all")
    with pytest.raises(UsageError, match=rf"a\.{name[2:]} (is not a readable mesh; export it|has no triangles)"):
        files.read(tmp_path, bar=0.2)


def test_curves_alone_and_an_empty_folder_meet_a_sentence(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nl 1 2\n")
    with pytest.raises(UsageError, match=r"a.obj has no triangles; export the surface"):
        files.read(tmp_path, bar=0.2)
    (tmp_path / "a.obj").unlink()
    with pytest.raises(UsageError, match=r"holds no gate \(.png, .obj, .*labels.json"):
        files.read(tmp_path, bar=0.2)
    with pytest.raises(UsageError, match="is not a folder; give a folder of pictures"):
        files.read(tmp_path / "absent", bar=0.2)
