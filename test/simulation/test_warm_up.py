"""What is said before kernels are compiled."""

import pytest

from softrobot_twin import kernel_cache
from softrobot_twin.kernel_cache import closure_hash
from softrobot_twin.simulation.warm_up import tell_of_compilation


@pytest.mark.parametrize("kernel_count, is_told", [(0, True), (10, True), (60, False)])
def test_a_first_compilation_is_told_once(tmp_path, monkeypatch, caplog, kernel_count, is_told):
    present = closure_hash("softrobot_twin.geometry.vector3")[:16]
    for number in range(kernel_count):
        (tmp_path / f"geometry.vector3.row-{present}-{number}.nbc").touch()
        # Of sources that have changed.
        (tmp_path / f"geometry.vector3.row-{'0' * 16}-{number}.nbc").touch()
    monkeypatch.setattr(kernel_cache, "kernel_folder", lambda: tmp_path)
    tell_of_compilation.cache_clear()
    tell_of_compilation()
    tell_of_compilation()
    assert caplog.text.count("compiled for this machine, once") == is_told
