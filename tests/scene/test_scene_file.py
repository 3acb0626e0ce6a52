"""Scene files: what is written is read again, and what is wrong is named."""

from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lensshift.core.errors import DataError
from lensshift.scene import (
    Checker,
    Constant,
    Cuboid,
    Edge,
    ImageTexture,
    LinePairs,
    Mesh,
    Plane,
    Rectangle,
    Scene,
    SiemensStar,
    Sphere,
    ZonePlate,
    cast,
    four_boxes,
    load_scene,
    save_scene,
)

TEXTURES = (
    0.25,
    Constant(0.5),
    Checker(0.1, dark=0.2),
    Edge(0.3, 0.1, 0.6),
    SiemensStar(0.2, cycles=7, binary=True),
    ZonePlate(0.3, 0.02),
    LinePairs((0.1, 0.05), 0.4, bright=0.9),
)


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_shapes_and_textures_come_back(tmp_path: Path) -> None:
    places = [(0.1 * n, -0.2, 3.0 + n) for n in range(len(TEXTURES))]
    objects = (
        Sphere(centre_m=(0, 0, 1), radius_m=0.3, name='the "ball" \\ \u00e4'),
        Cuboid(centre_m=(1e-7, 2e22, 1), size_m=(1, 2, 3), turn_rad=(0.1, -0.2, 3.0)),
        Plane(centre_m=(0, 0, 9), turn_rad=(0.0, 1.0, 0.0)),
        *(Rectangle(centre_m=at, size_m=(1, 2), reflectance=texture)
          for at, texture in zip(places, TEXTURES, strict=True)),
    )  # fmt: skip
    for scene in (Scene(objects, background=Plane(centre_m=(0, 0, 10))), Scene(objects[:1])):
        save_scene(scene, tmp_path / "scene.toml")
        again = load_scene(tmp_path / "scene.toml")
        for shape, other in zip(scene.shapes, again.shapes, strict=True):
            assert type(shape) is type(other)
            assert (shape.name, shape.centre_m) == (other.name, other.centre_m)
            np.testing.assert_allclose(other.rotation, shape.rotation, atol=1e-15)
            assert getattr(other, "size_m", None) == getattr(shape, "size_m", None)
            assert type(other.reflectance) is type(shape.reflectance)
            x_m, y_m = np.random.default_rng(0).uniform(-0.3, 0.3, (2, 500))
            np.testing.assert_array_equal(other.texture(x_m, y_m), shape.texture(x_m, y_m))


def test_equal_scenes_are_equal(tmp_path: Path) -> None:
    save_scene(four_boxes(), tmp_path / "boxes.toml")
    assert load_scene(tmp_path / "boxes.toml") == four_boxes()
    package = resources.files("lensshift.scene") / "four_boxes.toml"
    assert load_scene(str(package)) == four_boxes()
    text = (tmp_path / "boxes.toml").read_text(encoding="utf-8")
    assert load_scene(written(tmp_path, text.replace("0.85", "0.84"))) != four_boxes()


def test_meshes_and_pictures_are_written_out(tmp_path: Path) -> None:
    picture = ImageTexture(np.random.default_rng(0).uniform(size=(2, 3)), (0.3, 0.2))
    mesh = Mesh(
        vertices_m=np.random.default_rng(1).normal(size=(4, 3)), triangles=[[0, 1, 2], [1, 2, 3]],
        centre_m=(0, 0, 3), reflectance=picture,
    )  # fmt: skip
    save_scene(Scene((mesh,)), tmp_path / "mesh.toml")
    (again,) = load_scene(tmp_path / "mesh.toml").objects
    assert isinstance(again, Mesh)
    assert isinstance(again.reflectance, ImageTexture)
    np.testing.assert_array_equal(again.vertices_m, mesh.vertices_m)
    np.testing.assert_array_equal(again.triangles, mesh.triangles)
    np.testing.assert_array_equal(again.reflectance.image, picture.image)
    assert again.reflectance.size_m == picture.size_m


@pytest.mark.parametrize(
    ("pixels", "top"),
    [(np.array([[0, 51, 255]], dtype=np.uint8), 255), (np.array([[0], [65535]], np.uint16), 65535)],
)
def test_pictures_lie_beside_the_scene(tmp_path: Path, pixels: np.ndarray, top: int) -> None:
    (tmp_path / "cards").mkdir()
    Image.fromarray(pixels).save(tmp_path / "cards" / "card.png")
    text = """
        [[object]]
        shape = "rectangle"
        centre_m = [0, 0, 2]
        size_m = [1, 1]
        reflectance = { texture = "image", size_m = [1, 1], file = "cards/card.png" }
        """
    (card,) = load_scene(written(tmp_path, text)).objects
    np.testing.assert_allclose(card.reflectance.image, pixels / top)


def test_a_mesh_file_lies_beside_the_scene(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed")
    trimesh.creation.box((400, 300, 200)).export(tmp_path / "box.ply")
    text = """
        [[object]]
        shape = "mesh"
        file = "box.ply"
        unit_m = 0.001
        centre_m = [0, 0, 2]
        turn_deg = [0, 90, 0]
        """
    scene = load_scene(written(tmp_path, text))
    assert cast(scene, (0, 0, 1)).distance_m == pytest.approx(1.8)
    with pytest.raises(DataError, match=r"scene\.toml: object 1: .*gone\.ply: expected a mesh"):
        load_scene(written(tmp_path, text.replace("box.ply", "gone.ply")))


PLANE = '[[object]]\nshape = "plane"\ncentre_m = [0, 0, 1]\n'
CARD = '[[object]]\nshape = "rectangle"\nname = "card"\ncentre_m = [0, 0, 1]\nsize_m = [1, 1]\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "at least one"),
        ("[[object", "is not TOML: Expected"),
        ("[[thing]]", r"thing: expected \[\[object\]\]"),
        ("object = 3", r"object: expected tables headed"),
        ("object = [3]", "object 1: expected a table, got 3"),
        ("[object]", "object: expected tables headed"),
        ("background = 1", "background: expected a table"),
        ("[[object]]", "object 1: expected shape of plane, .* mesh, got None"),
        ('[[object]]\nshape = "cube"', "object 1: expected shape of .*got 'cube'"),
        ('[[object]]\nshape = ["plane"]', "object 1: expected shape of"),
        ('[[object]]\nshape = "plane"', "object 1: expected 'centre_m', which is missing"),
        (PLANE + "radius_m = 1", "object 1: expected .*reflectance.*, got 'radius_m'"),
        (PLANE + "turn_rad = [0, 0, 1]", "expected .*turn_deg.*, got 'turn_rad'"),
        (PLANE + "turn_deg = [0, 0]", "3 finite numbers for turn_deg"),
        (PLANE + 'turn_deg = [0, 0, "x"]', "number for each of turn_deg"),
        (PLANE + "reflectance = 1.5", "object 1: expected reflectance from 0 to 1"),
        (PLANE + 'reflectance = "white"', "number for reflectance"),
        (PLANE + "name = 3", "name: expected str, got 3"),
        (
            PLANE + 'reflectance = { texture = "siemens_star", radius_m = 1, binary = "false" }',
            "object 1, reflectance, binary: expected bool, got 'false'",
        ),
        (
            PLANE + 'reflectance = { texture = "siemens_star", radius_m = 1, cycles = true }',
            "object 1, reflectance, cycles: expected int, got True",
        ),
        (PLANE.replace("[0, 0, 1]", "[0, 0]"), "3 finite numbers for centre_m"),
        (PLANE.replace("[0, 0, 1]", "[0, 0, nan]"), "finite each of centre_m"),
        (PLANE.replace("[0, 0, 1]", "3.5"), "3 finite numbers for centre_m, got 3.5"),
        (PLANE + CARD.replace("[1, 1]", "[1, -1]"), r"object 2 \(card\): .*positive each of size"),
        (PLANE.replace("[[object]]", "[background]") + "size_m = 1", "background: .*'size_m'"),
        (CARD + "reflectance = {}", r"object 1 \(card\), reflectance: expected texture of"),
        (CARD + 'reflectance = { texture = "fur" }', "reflectance: .* got 'fur'"),
        (CARD + 'reflectance = { texture = "checker" }', "'size_m', which is missing"),
        (CARD + 'reflectance = { texture = "checker", size_m = 0 }', "positive size_m"),
        (CARD + 'reflectance = { texture = "edge", slant_deg = "x" }', "number for slant_deg"),
        (CARD + 'reflectance = { texture = "edge", slant_deg = inf }', "finite slant_deg"),
        (CARD + 'reflectance = { texture = "edge", file = "x" }', "got 'file'"),
        (
            CARD + 'reflectance = { texture = "image", size_m = [1, 1] }',
            "'image', which is missing",
        ),
        (
            CARD + 'reflectance = { texture = "image", size_m = [1, 1], file = "none.png" }',
            "reflectance: .*none.png: cannot read as a picture",
        ),
        (
            CARD + 'reflectance = { texture = "image", size_m = [1, 1], file = "colours.png" }',
            "colours.png: expected a grey picture of 8 or 16 bits, got RGB",
        ),
        (
            CARD + 'reflectance = { texture = "image", size_m = [1, 1], file = "scene.toml" }',
            "cannot read as a picture",
        ),
        (CARD + 'reflectance = { texture = "image", size_m = [1, 1], file = 3 }', "name of a file"),
        ('[[object]]\nshape = "mesh"\ncentre_m = [0, 0, 1]', "'vertices_m', which is missing"),
        (
            '[[object]]\nshape = "mesh"\nfile = "a.stl"\ncentre_m = [0, 0, 1]\ntriangles = []',
            "got 'triangles'",
        ),
        (
            '[[object]]\nshape = "mesh"\ncentre_m = [0, 0, 1]\nvertices_m = [[0, 0, 0]]\n'
            "triangles = [[0, 0, 1]]",
            "object 1: expected vertices 0 to 0 for triangles",
        ),
    ],
)
def test_mistakes_are_named_with_file_and_field(tmp_path: Path, text: str, message: str) -> None:
    Image.new("RGB", (2, 2)).save(tmp_path / "colours.png")
    with pytest.raises(DataError, match=rf"scene\.toml: .*{message}"):
        load_scene(written(tmp_path, text))


def test_files_that_are_no_text_are_named(tmp_path: Path) -> None:
    (tmp_path / "noise.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match=r"noise\.toml: expected a text file"):
        load_scene(tmp_path / "noise.toml")
    for path in (tmp_path / "gone.toml", tmp_path):
        with pytest.raises(DataError, match="cannot be read"):
            load_scene(path)
    with pytest.raises(DataError, match="cannot write"):
        save_scene(four_boxes(), tmp_path)


def test_only_known_shapes_and_textures_can_be_written(tmp_path: Path) -> None:
    class Wall(Plane):
        pass

    with pytest.raises(TypeError, match=r"shape of plane, .*, got Wall"):
        save_scene(Scene((Wall(centre_m=(0, 0, 1)),)), tmp_path / "scene.toml")
    striped = Plane(centre_m=(0, 0, 1), reflectance=lambda x, y: 0 * x)
    with pytest.raises(TypeError, match=r"texture of constant, .*, got function"):
        save_scene(Scene((striped,)), tmp_path / "scene.toml")
    assert not (tmp_path / "scene.toml").exists()
