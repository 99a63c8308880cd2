import builtins
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import small

from hmdjit import scenes
from hmdjit.camera import Camera, Region
from hmdjit.frames.displacement import Displacement
from hmdjit.scenes import pictures
from hmdjit.scenes.base import check_scene


@pytest.fixture(scope="module")
def study_set():
    return scenes.study_set()


def test_the_study_set_has_eleven_scenes_under_their_names(study_set):
    assert len(study_set) == 11
    assert all(scene.name == name for name, scene in study_set.items())
    assert all(name.replace("_", "").isalpha() for name in study_set)


def test_every_photograph_of_the_study_set_is_credited(study_set):
    photographs = {
        name
        for name, scene in study_set.items()
        if isinstance(scene, scenes.Photograph)
    }
    assert photographs == set(scenes.CREDITS)
    assert len(photographs) == 7
    for credit, licence in scenes.CREDITS.values():
        assert credit
        assert licence in ("CC0", "public domain")


@pytest.mark.slow
def test_the_study_set_bakes_to_one_shape_of_finite_colours(study_set):
    camera = Camera(32, 32, 96.0)
    shapes = set()
    for scene in study_set.values():
        if isinstance(scene, scenes.Photograph):
            # A corner of each: one program for all of them.
            corner = scene.planes[:, :256, :256]
            scene = eqx.tree_at(lambda s: s.planes, scene, corner)
        texture = scenes.bake(scene, camera)
        shapes.add(texture.color.shape)
        for texels in (texture.color, texture.supersampled):
            assert texels.dtype == jnp.float32
            # sRGB curves in float32 are right to a few 1e-7.
            assert (texels >= -1e-6).all()
            assert (texels <= 1 + 1e-6).all()
    assert len(shapes) == 1


@pytest.mark.slow
def test_the_default_camera_sees_the_study_set_as_it_claims(study_set):
    camera = Camera()
    still = Displacement(camera, Region.whole(camera), jnp.zeros(3, jnp.float32))
    for name, scene in study_set.items():
        texture = scenes.bake(scene, camera)
        assert texture.color.shape == (2540, 2540, 3)
        frame = np.asarray(texture.at(still))
        mean = np.asarray(texture.at(still, supersampled=True))
        if name == "almost_uniform":
            assert np.ptp(frame, axis=(1, 2)).max() * 255 < 7
        else:
            assert frame.std() > 0.05
        assert np.abs(frame - mean).mean() < 0.1


def test_scenes_are_leaves_and_names_so_that_they_can_be_told_apart():
    first, second = scenes.checkerboard(2.0), scenes.checkerboard(3.0)
    assert jax.tree.structure(first) == jax.tree.structure(second)
    assert jax.tree.leaves(first) != jax.tree.leaves(second)
    renamed = scenes.checkerboard(2.0, name="other")
    assert jax.tree.structure(first) != jax.tree.structure(renamed)


def test_importing_scenes_needs_the_core_packages_only():
    extra = ("skimage", "PIL", "matplotlib", "xarray")
    code = (
        "import sys, hmdjit.scenes;"
        f"sys.exit([name for name in {extra} if name in sys.modules] or 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("missing", "call"),
    [
        ("skimage", scenes.study_set),
        ("PIL", scenes.page_of_text),
        ("PIL", lambda: pictures.read_picture("any.png")),
    ],
)
def test_a_missing_package_is_named(missing, call, monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **named):
        if name.split(".")[0] == missing:
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"install `hmdjit\[study\]`"):
        call()


def test_text_that_is_not_static_is_refused():
    class Grey(scenes.AbstractFlatScene):
        name: str = "grey"

        def plane_color(self, camera, x, y):
            return jnp.full((3, *x.shape), 0.5)

    with pytest.raises(ValueError, match=r"^name must be static: eqx\.field"):
        Grey()


CAMERA = Camera(8, 8, 20.0)


def scene_of(paint, base: type = scenes.AbstractFlatScene):
    class Mine(base):
        name: str = eqx.field(static=True, default="mine")

        def plane_color(self, camera, x, y):
            return paint(x)

        def color(self, camera, direction):
            if base is scenes.AbstractScene:
                return paint(direction)
            return super().color(camera, direction)

    return Mine()


@pytest.mark.parametrize(
    "paint",
    [
        lambda x: x,
        lambda x: jnp.stack([x] * 3, -1),
        lambda x: jnp.stack([x] * 4),
        lambda x: [x, x, x],
        lambda x: None,
        lambda x: x if x.sum() > 0 else -x,
    ],
    ids=["grey", "channels last", "alpha", "list", "none", "condition"],
)
def test_a_flat_scene_must_return_colours(paint):
    message = r"^scene 'mine': plane_color\(camera, x, y\) must return .*, got "
    with pytest.raises(ValueError, match=message):
        scenes.bake(scene_of(paint), CAMERA)


@pytest.mark.parametrize(
    ("paint", "got"),
    [
        (lambda d: jnp.moveaxis(d, 0, -1), r"float64 of shape \(2, 5, 3\)"),
        (lambda d: jnp.full(d.shape, 200, jnp.uint8), r"uint8 of shape \(3, 2, 5\)"),
        (tuple, "tuple"),
        (lambda d: 0.5, r"float64 of shape \(\)"),
    ],
)
def test_a_scene_must_return_colours_in_every_study(paint, got):
    scene = scene_of(paint, scenes.AbstractScene)
    message = r"^scene '%s': color\(camera, direction\) must return .* got "
    with pytest.raises(ValueError, match=message % "mine" + got):
        scenes.bake(scene, CAMERA)
    with pytest.raises(ValueError, match=message % "room" + got):
        small.study(scenes={"room": scene})


@pytest.mark.parametrize("level", [200.0, -1.0])
def test_colours_out_of_range_are_refused(level):
    scene = scene_of(lambda x: jnp.full((3, *x.shape), level))
    with pytest.raises(ValueError, match=r"scene 'mine' must lie in \[0, 1\], got"):
        scenes.bake(scene, CAMERA)


@pytest.mark.parametrize(
    ("thing", "got"),
    [
        (scenes.checkerboard, "checkerboard itself"),
        (scenes.Photograph, "Photograph itself"),
        (np.zeros((8, 8, 3)), "an instance of ndarray"),
        ("photo.png", "an instance of str"),
    ],
)
def test_what_is_no_scene_is_refused(thing, got):
    with pytest.raises(ValueError, match=f"^scene must be an instance .*, got {got}"):
        check_scene(thing, CAMERA)
    with pytest.raises(ValueError, match=f"^scene 'room' must be .*, got {got}"):
        check_scene(thing, CAMERA, "room")


class Painted(scenes.AbstractFlatScene):
    grey: float
    name: str = eqx.field(static=True)

    def __init__(self, percent):
        self.grey, self.name = percent / 100, f"{percent} %"

    def plane_color(self, camera, x, y):
        return jnp.full((3, *x.shape), self.grey)


def test_a_scene_may_have_its_own_init():
    texture = scenes.bake(Painted(50), CAMERA, oversampling=1)
    assert (texture.color == 0.5).all()
