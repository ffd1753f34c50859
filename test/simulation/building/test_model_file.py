"""A damaged file of a reduced model is refused by one error that names it and what is wrong."""

import io
import zipfile
from contextlib import suppress

import numpy as np
import pytest
import yaml

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation.building import reduced_body
from softrobot_twin.simulation.building.reduced_body import ModelFile, ModelFileError
from softrobot_twin.simulation.building.scene_layout import lay_out
from test.places import ROOT

FILES = {"diamond_reduced": "diamond_600_reduced", "fetch_reduced": "fetch_5586_vertebrae"}


@pytest.fixture(params=list(FILES))
def model(request, tmp_path):
    """Bytes of a file that is shipped, and a function that lays out its scene with other bytes."""
    scene = ROOT / "config" / "scenes" / f"{request.param}.yaml"
    mapping = yaml.safe_load(scene.read_text())
    body, path = mapping["body"], tmp_path / "model.npz"
    if "reduced" in body:
        body["reduced"] = {"file": str(path)}
    else:
        body["vertebrae"]["superelements"] = str(path)

    def lay(content: bytes):
        path.write_bytes(content)
        return lay_out(scene_from_mapping(mapping, scene), [])

    return (ROOT / "meshes" / f"{FILES[request.param]}.npz").read_bytes(), lay


def arrays_of(content: bytes) -> dict:
    with np.load(io.BytesIO(content)) as saved:
        return dict(saved)


def saved(arrays: dict) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def unpacked(content, member) -> bytes | None:
    """What a member contains; None where it cannot be read."""
    with suppress(Exception), zipfile.ZipFile(io.BytesIO(content)) as archive:
        return archive.read(member.filename)


def refused(lay, content) -> str:
    """The error, in one line that names the file and the command that makes another."""
    with pytest.raises(SceneError) as caught:
        lay(content)
    told = str(caught.value)
    assert "model.npz" in told and "run: softrobot_twin reduce" in told and "\n" not in told
    return told


@pytest.mark.sampled
def test_a_file_that_was_cut_or_whose_bits_changed_is_refused(model, drawn_rng):
    whole, lay = model
    lay(whole)
    damaged = [b"", b"hello", whole[: drawn_rng.integers(1, len(whole))]]
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        for member in drawn_rng.choice(archive.infolist(), 3, replace=False):
            # Beyond the member's own header, which holds times that nobody reads.
            place = member.header_offset + 30 + len(member.filename) + 20
            changed = bytearray(whole)
            # Bits that fill up the last byte say nothing; others may say the same in another way.
            while unpacked(changed, member) == archive.read(member):
                changed = bytearray(whole)
                changed[int(place + drawn_rng.integers(member.compress_size))] ^= 1 << drawn_rng.integers(8)
            damaged.append(changed)
    for content in damaged:
        refused(lay, bytes(content))


@pytest.mark.sampled
def test_each_array_is_refused_missing_of_another_shape_or_kind_or_with_infinite_numbers(model, drawn_rng):
    whole, lay = model
    arrays = arrays_of(whole)
    for name in drawn_rng.choice(list(arrays), 2, replace=False):
        array = arrays[name]
        assert f"no array {name}" in refused(lay, saved({k: arrays[k] for k in {*arrays} - {name}}))
        refused(lay, saved({**arrays, name: array[None]}))
        kind = complex if array.dtype.kind != "U" else str
        other = array.astype(kind) if kind is complex else np.zeros(array.shape)
        assert "are needed" in refused(lay, saved({**arrays, name: other}))
        if array.dtype.kind == "f":
            changed = np.array(array)
            changed.flat[drawn_rng.integers(changed.size)] = -np.inf
            assert f" {name} are not between" in refused(lay, saved({**arrays, name: changed}))


@pytest.mark.sampled
def test_what_does_not_fit_the_body_is_refused(model):
    whole, lay = model
    arrays = arrays_of(whole)
    if "basis" in arrays:
        basis, cells = arrays["basis"], arrays["sampled_cells"]
        twice = basis.copy()
        twice[:, :, 1] = twice[:, :, 0]
        cases = [
            ({"basis": basis[:-1]}, "basis has shape"), ({"mode_count": -3}, "mode_count"),
            ({"mode_count": 4}, "multiples of three"), ({"basis": basis + 1e-3}, "fixed nodes"),
            ({"basis": twice}, "not positive definite"),
            ({"sampled_cells": cells + 10**6}, "sampled_cells"),
            ({"sampled_points": arrays["sampled_points"] + 9}, "its cells do not have"),
            ({"sampled_cells": 0 * cells, "sampled_points": 0 * cells}, "the same twice"),
            ({"sampled_weights": -arrays["sampled_weights"]}, "sampled_weights"),
            ({"training": "{"}, "training is no JSON"),
        ]  # fmt: skip
        few = {name: arrays[name][:2] for name in arrays if name.startswith("sampled_")}
        cases.append((few, "too few points"))
    else:
        cases = [
            ({"count": 5}, "5 superelements for 6"), ({"degree": 1}, "degree"),
            ({"ends_1": arrays["ends_1"] + 1}, "not between its vertebrae"),
            ({"coefficients_2": -arrays["coefficients_2"]}, "superelement 2 is not positive"),
            ({"scaling_0": 0 * arrays["scaling_0"]}, "superelement 0 is not positive"),
            ({"rest_volumes": 0 * arrays["rest_volumes"]}, "rest_volumes"),
        ]  # fmt: skip
    for change, told in cases:
        assert told in refused(lay, saved({**arrays, **change})), told
    prints = np.array([entry.replace("mesh=", "mesh=0") for entry in arrays["prints"]])
    assert "was made of another mesh;" in refused(lay, saved({**arrays, "prints": prints}))


def test_a_file_that_unpacks_to_too_much_or_to_less_than_it_says_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "model.npz"
    np.savez_compressed(path, basis=np.zeros(10**6))
    assert path.stat().st_size < 20_000
    assert (ModelFile(path).taken("basis", None) == 0.0).all()
    monkeypatch.setattr(reduced_body, "MOST_BYTES", 7_000_000)
    with pytest.raises(ModelFileError, match="unpacks to 8 MB, the most is 7 MB"):
        ModelFile(path)
    # The table of the archive says less than what is packed.
    told = path.read_bytes().replace((8_000_128).to_bytes(4, "little"), b"\x00\x01\x00\x00")
    path.write_bytes(told)
    with pytest.raises(ModelFileError, match="or damaged"):
        ModelFile(path)


def test_arrays_that_hold_objects_are_not_unpacked(tmp_path):
    path = tmp_path / "model.npz"
    np.savez(path, basis=np.array([{}], object))
    with pytest.raises(ModelFileError, match="Object arrays cannot be loaded"):
        ModelFile(path)
