"""Samples that are lost, as where a worker has no power."""

from softrobot_twin.harness.sample_workers import LocalWorkers, SampleOutcome


def lose_second(monkeypatch):
    """Lets the local workers lose the second of all samples."""
    def run(self, job, asked):
        compute = job.make(job.scene, job.content)
        for index, content in asked:
            lost = index == 1
            yield SampleOutcome(index, None if lost else compute(content), "no power" if lost else "")

    monkeypatch.setattr(LocalWorkers, "run", run)
