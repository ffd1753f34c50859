"""What is said before kernels are compiled."""

import pytest

from softrobot_twin.simulation.warm_up import tell_of_compilation


@pytest.mark.parametrize("kernel_count, is_told", [(0, True), (10, True), (100, False)])
def test_a_first_compilation_is_told_once(tmp_path, monkeypatch, caplog, kernel_count, is_told):
    for number in range(kernel_count):
        (tmp_path / "mechanics").mkdir(exist_ok=True)
        (tmp_path / f"mechanics/kernel_{number}.nbi").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    tell_of_compilation.cache_clear()
    tell_of_compilation()
    tell_of_compilation()
    assert caplog.text.count("compiled for this machine, once") == is_told
