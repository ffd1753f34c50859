"""The scripts and the notebook of `examples/`: each runs as it is and shows what it promises."""

import runpy

import numpy as np
import pytest

from test.places import ROOT

EXAMPLES = ROOT / "examples"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Runs an example in an empty folder; returns its variables."""
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    from matplotlib import pyplot

    def run_example(name, *arguments):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr("sys.argv", [f"{name}.py", *arguments])
        return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")

    yield run_example
    pyplot.close("all")


def test_the_finger_reaches_its_three_places(run, tmp_path, capsys):
    result = run("finger")["result"]
    assert result.status.value == "ok"
    assert np.linalg.norm(result.tip - [0.065, 0.0, -0.048]) < 1e-5
    printed = capsys.readouterr().out
    assert printed.count("; ok\n") == 3 and "flexor_shortening_m" in printed
    assert (tmp_path / "finger.png").stat().st_size > 10_000


def test_the_finger_bends_to_the_angles_that_its_sensor_shall_show(run):
    seen = run("sensors")
    np.testing.assert_allclose(seen["shown"], seen["angles"], atol=1e-5)  # rad
    assert (np.diff(seen["string"]) > 0.0).all()


def test_the_finger_presses_as_hard_as_is_wanted(run):
    seen = run("pressing_finger")
    np.testing.assert_allclose(seen["felt"], seen["wanted"], rtol=1e-3)  # N


@pytest.mark.exhaustive
def test_the_cube_swings_under_the_cup_and_falls_when_it_is_let_go(run):
    seen = run("pick_and_place")
    forces, places = np.array(seen["forces"]), seen["places"]
    assert forces[40] == pytest.approx(0.01 * 9.81, rel=1e-2) and forces.max() < 0.3  # N
    assert 0.02 < seen["swing"] < 0.06 and (forces[-20:] == 0.0).all()  # m
    assert places[-1, 0] - places[270, 0] > 0.04


def test_the_push_on_the_diamond_is_found(run):
    seen = run("external_force")
    assert seen["forces"][-1] == pytest.approx(seen["PUSH"], abs=0.05)  # N
    assert np.abs(seen["forces"][:5]).max() < 0.05


@pytest.mark.exhaustive
def test_the_arm_of_muscles_yields_less_where_it_is_stiffer(run, tmp_path):
    seen = run("muscular_arm")
    assert all(0.0 < value <= 1.0 for value in seen["activations"].values())
    assert seen["yields"][1e6] < 0.5 * seen["yields"][100e3]
    assert (tmp_path / "muscular_arm.png").stat().st_size > 10_000


@pytest.mark.exhaustive
def test_the_trunk_follows_its_path_while_the_cylinders_carry_it(run, tmp_path):
    seen = run("trunk_in_contact")
    assert seen["errors"].max() < 0.1  # mm
    assert seen["forces"][0] == 0.0 and seen["forces"].max() > 0.05  # N
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "trunk_in_contact.png", "trunk_in_contact_end.png"}


@pytest.mark.exhaustive
def test_the_gripper_lifts_the_ball_with_its_palm(run, tmp_path):
    heights = run("pneumatic_gripper")["heights"]  # mm
    assert abs(heights[:100]).max() < 1.0, "it stands on the floor until it is lifted"
    assert heights[-1] == pytest.approx(40.0, abs=2.0)
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "pneumatic_gripper.png", "pneumatic_gripper_end.png"}


@pytest.mark.exhaustive
def test_fingers_lead_a_cube_along_a_circle(run, tmp_path):
    seen = run("in_hand")
    assert seen["errors"].max() < 0.2 and seen["errors"][-1] < 0.01  # mm
    assert np.nanmin(seen["margins"]) > 0.0
    assert {path.name for path in tmp_path.glob("*.png")} == {"in_hand.png", "in_hand_end.png"}


@pytest.mark.exhaustive
def test_calibration_finds_the_modulus_of_the_real_finger(run, tmp_path):
    seen = run("calibration")
    assert seen["fit"].success and seen["fit"].x == pytest.approx(437e3, rel=0.01)
    # What the fit does not know matters: the modulus of the data sheet does not explain it.
    wrong = np.abs(seen["sags"](500e3) - seen["measured"]).max()
    right = np.abs(seen["sags"](seen["fit"].x) - seen["measured"]).max()
    assert right < 0.3e-3 < 2e-3 < wrong
    assert (tmp_path / "calibration.png").is_file()


@pytest.mark.exhaustive
def test_a_camera_cuts_the_error_of_the_finger_to_less_than_a_half(run, tmp_path):
    seen = run("closed_loop")
    open_error = seen["errors"][seen["is_open"]].mean()
    closed_error = seen["errors"][seen["is_closed"]].mean()
    assert closed_error < 0.5 * open_error and open_error > 0.3  # mm
    assert (tmp_path / "closed_loop.png").is_file()


@pytest.mark.exhaustive
def test_a_trunk_is_led_faster_by_prediction(run, tmp_path):
    paths = run("fast_trunk")["paths"]
    errors = {law: np.sqrt(((real - wanted)[:, 50:] ** 2).sum(axis=0).mean())
              for law, (real, wanted) in paths.items()}  # fmt: skip
    assert errors["dynamic"] < 0.2 * errors["quasi_static"] and errors["dynamic"] < 2.0  # mm
    assert (tmp_path / "fast_trunk.png").is_file()


@pytest.mark.exhaustive
def test_a_policy_learns_within_a_few_generations(run, tmp_path):
    pytest.importorskip("gymnasium")
    seen = run("learning", "4")
    finger, untrained = seen["finger"], np.zeros(seen["shape"])
    before = 1e3 * np.mean([seen["last_distance"](untrained, one) for one in seen["unknown"]])
    assert len(seen["history"]) == 4
    assert seen["history"][-1] < 0.7 * before
    assert np.isfinite(finger.target).all()
    assert (tmp_path / "learning.png").is_file()


@pytest.mark.exhaustive
def test_a_policy_learned_on_many_reduced_robots_serves_the_full_model_and_the_device(run, tmp_path):
    pytest.importorskip("gymnasium")
    far = run("many_robots", "25")["far"]
    assert np.mean(far[-3:]) < 0.5 * far[0], "it learns while it explores"
    found = {name: one.mean() for name, one in run("policy_on_device")["found"].items()}
    assert found["reduced model"] < 0.5 * found["no policy"]
    for other in ("full model", "device"):
        assert found[other] < found["reduced model"] + 1.5, f"the {other} [mm]"
    assert {path.name for path in tmp_path.iterdir()} == {
        "many_robots.png", "policy.csv", "policy_on_device.png"}


@pytest.mark.exhaustive
def test_a_cable_is_led_so_that_the_tip_passes_four_places(run, tmp_path, capsys):
    seen = run("design")
    places = seen["tips"](seen["st"].load("designed.yaml"))
    errors = np.linalg.norm(places - 1e3 * np.array(seen["wanted"]), axis=1)  # mm
    assert seen["design"].before > 4e-3 and errors.max() < 0.6
    assert "flatness" in capsys.readouterr().out and (tmp_path / "design.png").is_file()


def slopes_by_differences(model, values, weights):
    """Derivatives of weighted places and efforts of the poses of a model."""
    ends = [[sum(map(np.vdot, weights, model.solve(values + side * step).found)) for side in (1, -1)]
            for step in 1e-3 * np.eye(len(values))]
    return np.array([(one - other) / 2e-3 for one, other in ends])


@pytest.fixture
def drawn(drawn_rng):
    """Heights [mm], and weights of places and efforts of two poses."""
    return (drawn_rng.uniform(-1.0, 1.0, 2), 1e3 * drawn_rng.normal(size=(2, 1, 3)), drawn_rng.normal(size=(2, 2)))


def test_gradients_inside_torch_are_those_of_differences(run, drawn):
    torch = pytest.importorskip("torch")
    seen, (heights, *weights) = run("gradients_torch"), drawn
    assert np.allclose(seen["values"].detach().numpy(), [0.8, -1.2], atol=1e-3)
    values = torch.tensor(heights, requires_grad=True)
    sum((torch.tensor(by) * one).sum() for by, one in zip(weights, seen["poses"](values))).backward()
    expected = slopes_by_differences(seen["model"], heights, weights)
    np.testing.assert_allclose(values.grad.numpy(), expected, rtol=1e-4, atol=1e-5)


def test_gradients_inside_jax_are_those_of_differences(run, drawn):
    jax = pytest.importorskip("jax")
    seen, (heights, *weights) = run("gradients_jax"), drawn
    assert np.allclose(seen["found"].x, [0.8, -1.2], atol=1e-3)
    slopes = jax.jit(jax.grad(lambda own: sum((by * one).sum() for by, one in zip(weights, seen["poses"](own)))))
    expected = slopes_by_differences(seen["model"], heights, weights)
    np.testing.assert_allclose(np.asarray(slopes(heights)), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.exhaustive
def test_the_notebook_runs_and_shows_three_pictures():
    nbformat = pytest.importorskip("nbformat")
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    pytest.importorskip("matplotlib")
    notebook = nbformat.read(EXAMPLES / "finger.ipynb", 4)
    client = nbclient.NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": EXAMPLES}})
    client.execute()  # An error in a cell is raised here.
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert [output.name for output in outputs if output.output_type == "stream"] == []
    assert sum("image/png" in output.data for output in outputs) == 3
    shown = " ".join(output.data["text/plain"] for output in outputs)
    assert "<Robot finger: " in shown and "unreachable" in shown and "200 kPa" in shown
