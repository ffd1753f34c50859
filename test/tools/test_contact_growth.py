"""The growth of a step with its contacts, at the size of a test."""

import pytest
from contact_growth import contact_table, draw_contacts, measure_contacts, write_contacts

from softrobot_twin.study.bench_measurement import WHOLE_STEP
from test.run_files import rows_of


@pytest.mark.exhaustive
def test_more_contacts_make_more_rows_on_the_same_matrix(tmp_path):
    few, many = found = measure_contacts(tmp_path, 5, (3, 6))
    assert few.dof_count == many.dof_count
    assert 9 <= few.contact_count < 36 <= many.contact_count
    assert many.row_count > few.row_count >= 3 * few.contact_count
    assert few.stages["optimise"].median < few.stages[WHOLE_STEP].median
    write_contacts(tmp_path / "contacts.csv", found)
    rows = rows_of(tmp_path / "contacts.csv")
    assert len(rows) == 2 * len(few.stages)
    assert {row["contacts"] for row in rows} == {f"{one.contact_count:g}" for one in found}
    assert contact_table(found).row_count == 3
    pytest.importorskip("matplotlib")
    draw_contacts(tmp_path / "contacts.png", found, "here")
    assert (tmp_path / "contacts.png").read_bytes().startswith(b"\x89PNG")
