"""``tools/measure_condensation.py`` times rows that touch few and many nodes."""

import measure_condensation


def test_it_measures_rows_of_cables_and_cavities_on_the_same_mesh():
    measured = measure_condensation.measure_all(2, ("springy_400",), ("fetch_1500",))
    assert [(one.mesh, one.rows) for one in measured] == [
        ("springy_400", "1 cable"), ("springy_400", "1 cavity"), ("fetch_1500", "1 cavity"),
        ("fetch_1500", "3 cavities"), ("fetch_1500", "6 cavities")]
    cable, cavity, *fetches = measured
    assert cable.nodes <= 4 and cavity.nodes > 150
    assert len({one.nodes for one in fetches}) == 1
    for one in measured:
        assert 0.0 < one.condense < one.step and 0.0 < one.factor < one.step
