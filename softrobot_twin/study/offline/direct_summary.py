"""A direct run in a few numbers: how high, how still while held, how hard, how fast."""

from __future__ import annotations

from collections import Counter

import numpy as np

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.offline.direct_run import DirectRow, pair_names, rigid_poses
from softrobot_twin.study.offline.run_summary import spread


class DirectSummary:
    """Gathers rows as they come; keeps a few numbers a row and no state."""

    def __init__(self, simulation: Simulation, hold: tuple[float, float]):
        """Look at the scene before it moves.

        Args:
            simulation: Where it stands now is what heights are measured from.
            hold: Beginning and end of the time in which creep is measured [s]; NaN for none.
        """
        self._hold = hold
        self._effectors = simulation.effector_names
        self._pairs = pair_names(simulation)
        self._free = [index for index, part in enumerate(simulation.model.rigid) if part.is_free]
        self._free_names = [simulation.model.rigid[index].name for index in self._free]
        gravity = np.array(simulation.scene.gravity)
        weight = np.linalg.norm(gravity)
        self._up = -gravity / weight if weight > 0.0 else np.array([0.0, 0.0, 1.0])
        self._before = rigid_poses(simulation)[self._free, :3]
        self._times: list[float] = []
        self._rigid: list[np.ndarray] = []
        self._tips: list[np.ndarray] = []
        self._resultants: list[np.ndarray] = []
        self._sums: list[np.ndarray] = []
        self._counts: list[int] = []
        self._compute_times: list[float] = []
        self._residual = 0.0
        self.statuses: Counter[str] = Counter()
        self.failed = 0

    def add(self, row: DirectRow) -> None:
        """Counts one row."""
        self._times.append(row.time)
        self._rigid.append(row.rigid_poses[self._free, :3])
        self._tips.append(row.result.effector_positions)
        self._resultants.append(np.linalg.norm(row.pair_resultants, axis=1))
        self._sums.append(row.pair_magnitude_sums)
        self._counts.append(row.result.report.contact_count)
        self._compute_times.append(row.result.report.compute_time)
        self._residual = float(np.fmax(self._residual, row.result.report.residual))
        self.statuses[row.result.status.value] += 1
        self.failed += row.result.status.is_failure

    def heights(self) -> dict[str, tuple[float, float]]:
        """How far each free body rose at most [m], and when [s]."""
        risen = (np.array(self._rigid) - self._before) @ self._up
        return {name: (float(way.max()), self._times[int(way.argmax())])
                for name, way in zip(self._free_names, risen.T, strict=True)}

    def creep(self) -> dict[str, float]:
        """Longest distance from where each was when the hold began [m]; empty without a hold.

        Of free bodies; where there are none, of effectors.
        """
        begin, end = self._hold
        times = np.array(self._times)
        held = np.flatnonzero((times > begin - 1e-9) & (times < end + 1e-9))
        if not held.size:
            return {}
        names, places = self._free_names, np.array(self._rigid)
        if not names:
            names, places = self._effectors, np.array(self._tips)
        ways = np.linalg.norm(places[held] - places[held[0]], axis=2)
        return dict(zip(names, map(float, ways.max(axis=0)), strict=True))

    def lines(self) -> list[tuple[str, str]]:
        """What was found, as name and value with its unit."""
        compute = spread(1e3 * np.array(self._compute_times))
        lines = [("steps", f"{len(self._times)}, {self._times[-1]:.6g} s at their end")]
        lines += [(f"{name}, highest", f"{1e3 * height:+.2f} mm at {time:.2f} s")
                  for name, (height, time) in self.heights().items()]
        begin, end = self._hold
        lines += [(f"{name}, creep while held", f"{1e3 * way:.3f} mm in {begin:g}..{end:g} s")
                  for name, way in self.creep().items()]
        lines.append(("contacts, most", str(max(self._counts))))
        resultants, sums = np.array(self._resultants), np.array(self._sums)
        for index, (first, second) in enumerate(self._pairs):
            touched = sums[:, index] > 0.0
            if touched.any():
                whole, summed = resultants[touched, index], sums[touched, index]
                lines.append((f"force on {first} by {second}",
                              f"resultant median {np.median(whole):.3f} N, most "
                              f"{whole.max():.3f} N; sum of magnitudes median "
                              f"{np.median(summed):.3f} N, most {summed.max():.3f} N; "
                              f"touching in {100 * touched.mean():.0f} % of steps"))
        lines += [("compute time, median", f"{compute.median:.2f} ms"),
                  ("compute time, p99", f"{compute.p99:.2f} ms"),
                  ("compute time, max", f"{compute.maximum:.2f} ms")]
        lines += [(f"status {name}", f"{count} steps")
                  for name, count in sorted(self.statuses.items())]
        return lines
