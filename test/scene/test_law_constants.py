"""Constants of laws in scenes: what each law takes, and what is refused by name and unit."""

import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation.building.deformable_body import law_at_rest

MOONEY = {"law": "mooney_rivlin", "constants": {"c10": 40e3, "c01": 10e3}}
OGDEN = {"law": "ogden", "constants": {"shear_moduli": [40e3, 1e3], "exponents": [1.5, 6.0]}}
YEOH = {"law": "yeoh", "constants": {"c1": 50e3, "c2": -200.0, "c3": 15.0}}


def scene_of(material, *materials):
    body = {"mesh": {"file": "body.vtk"}, "material": {"density": 1000.0, **material}}
    if materials:
        body["materials"] = list(materials)
    return scene_from_mapping({"name": "rubber", "body": body})


@pytest.mark.parametrize("entry", [MOONEY, YEOH], ids=lambda entry: entry["law"])
def test_laws_of_own_constants_have_their_small_strain_moduli(entry):
    """µ = 2 (c₁₀ + c₀₁) and µ = 2 c₁ are 100 kPa."""
    by_ratio = law_at_rest(scene_of({**entry, "poisson_ratio": 0.4}).body.material, entry["law"])
    assert (by_ratio.young_modulus, by_ratio.poisson_ratio) == (pytest.approx(280e3), 0.4)
    bulk = 280e3 / (3.0 * (1.0 - 0.8))
    assert by_ratio.parameters.bulk_modulus == pytest.approx(bulk)
    by_bulk = law_at_rest(scene_of({**entry, "bulk_modulus": bulk}).body.material, entry["law"])
    assert by_bulk[1:] == pytest.approx(by_ratio[1:])
    own = law_named(entry["law"]).own
    assert by_bulk.parameters == own.parameters(entry["constants"], bulk)


def test_a_law_of_moduli_takes_a_bulk_modulus_in_place_of_poissons_ratio():
    material = scene_of({"young_modulus": 3e5, "bulk_modulus": 1e6}).body.material
    assert law_at_rest(material, material.law).poisson_ratio == pytest.approx(0.5 - 3e5 / 6e6)


def test_a_part_of_a_body_takes_the_constants_of_its_own_law():
    base = {"young_modulus": 1e5, "poisson_ratio": 0.45}
    body = scene_of(base, {"region": "skin", **YEOH}, {"region": "core", "young_modulus": 3e5}).body
    skin, core = (law_at_rest(part, part.law or body.material.law, body.material)
                  for part in body.materials)  # fmt: skip
    assert skin[1:] == pytest.approx((2.9 * 100e3, 0.45)) and core[1:] == (3e5, 0.45)
    assert type(skin.parameters).__name__ == "Yeoh"


def changed(entry, **constants):
    return {**entry, "constants": {**entry["constants"], **constants}, "poisson_ratio": 0.4}


@pytest.mark.parametrize("material, key, unit, reason", [
    (changed(MOONEY, c1=2.0), "constants.c1", "", "c10, c01 [Pa]"),
    ({**MOONEY, "constants": {"c10": 1e4}, "poisson_ratio": 0.4}, "constants.c01", "Pa",
     "required"),
    (changed(MOONEY, c01=-40e3), "constants", "Pa", "must be above 0 Pa"),
    (changed(YEOH, c1="50 kPa"), "constants.c1", "", "without its unit"),
    (changed(YEOH, c2=True), "constants.c2", "", "must be a number"),
    (changed(YEOH, c2=float("inf")), "constants.c2", "", "finite"),
    (changed(YEOH, c2=1e31), "constants.c2", "Pa", "1e+30"),
    (changed(YEOH, c2=[1.0, 2.0]), "constants.c2", "Pa", "one number"),
    ({"law": "yeoh", "constants": 3, "poisson_ratio": 0.4}, "constants", "", "section"),
    ({"law": "yeoh", "poisson_ratio": 0.4}, "constants", "", "c1, c2, c3 [Pa]"),
    ({**MOONEY, "poisson_ratio": 0.4, "young_modulus": 1e5}, "young_modulus", "Pa", "constants"),
    (changed(OGDEN, exponents=[1.5]), "constants", "", "2 shear_moduli and 1 exponents"),
    (changed(OGDEN, exponents=[1.5, 0.0]), "constants", "", "an exponent is 0"),
    (changed(OGDEN, shear_moduli=4e4), "constants.shear_moduli", "Pa", "a list of numbers"),
    (changed(OGDEN, shear_moduli=[4e4, "x"]), "constants.shear_moduli[1]", "", "a number"),
    (changed(OGDEN, exponents=[-1.5, 6.0]), "constants", "Pa", "must be above 0 Pa"),
    (MOONEY, "poisson_ratio", "", "bulk_modulus [Pa]"),
    ({**MOONEY, "poisson_ratio": 0.4, "bulk_modulus": 1e6}, "bulk_modulus", "Pa", "0.4"),
    ({**changed(MOONEY), "law": "neo_hookean", "young_modulus": 1e5}, "constants", "",
     "no constants"),
    ({"law": "neo_hookean", "poisson_ratio": 0.4}, "young_modulus", "Pa", "required"),
    ({"young_modulus": 9e5, "bulk_modulus": 9e4}, "bulk_modulus", "Pa", "above"),
])  # fmt: skip
def test_wrong_constants_are_refused_by_name_and_unit(material, key, unit, reason):
    with pytest.raises(SceneError) as refused:
        scene_of(material)
    assert refused.value.key == f"body.material.{key}"
    assert refused.value.unit == unit and reason in refused.value.reason
    base = {"young_modulus": 1e5, "poisson_ratio": 0.4}
    if key == "poisson_ratio":
        return  # A part without one has that of its body.
    part = {"region": "b", "law": "corotational", **material}
    with pytest.raises(SceneError) as refused:
        scene_of(base, {"region": "a", "young_modulus": 1e5}, part)
    assert refused.value.key == f"body.materials[1].{key}"
    assert refused.value.unit == unit
