
import pytest

from softrobot_twin.view.recording import CAN_SERVE

pytestmark = pytest.mark.libraries


@pytest.mark.skipif(not CAN_SERVE, reason="this rerun cannot look into a layout")
def test_a_file_carries_its_layout_with_a_view_for_all_that_is_drawn(stage, make_frame, tmp_path):
    from rerun.chunk import RrdReader

    from softrobot_twin.view import RerunMirror
    with RerunMirror(stage, serve=False, record=tmp_path / "run.rrd") as mirror:
        mirror.offer(make_frame(0))
    reader = RrdReader(tmp_path / "run.rrd")
    (layout,) = reader.blueprints()
    chunks = reader.stream(store=layout).to_chunks()

    def texts(component):
        return {text for chunk in chunks for batch in [chunk.to_record_batch()]
                if component in batch.schema.names
                for cell in batch.column(component).to_pylist() for text in cell}

    assert {"3D", "TimeSeries", "TextLog"} <= texts("ViewBlueprint:class_identifier")
    shown = texts("ViewBlueprint:space_origin") | texts("ViewContents:query")
    drawn = {chunk.entity_path for chunk in reader.stream().to_chunks()} - {"/", "/__properties"}
    for path in drawn:
        assert {path, f"/{path.split('/')[1]}/**"} & shown, path
