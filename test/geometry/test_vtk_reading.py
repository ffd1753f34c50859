"""VTK XML files: every form of their arrays, and files that unpack to far more than they are."""

import base64
import struct
import zlib

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.mesh_reading import read_mesh_file, read_solid_mesh
from softrobot_twin.geometry.surface_reading import read_solid_surface
from softrobot_twin.geometry.vtk_reading import MOST_UNPACKED, read_vtk_xml

HEAD = ('<VTKFile type="UnstructuredGrid" version="0.1" byte_order="{order}" '
        'header_type="{header}"{compressor}>')  # fmt: skip


def encoded(values, header, order, compressor, encoding, block=100):
    """An array as VTK writes it."""
    raw = values.astype(values.dtype.newbyteorder(order)).tobytes()
    count = np.dtype(order + {"UInt32": "u4", "UInt64": "u8"}[header])
    if compressor is None:
        head, body = np.array([len(raw)], count).tobytes(), raw
    else:
        parts = [zlib.compress(raw[start : start + block]) for start in range(0, len(raw), block)]
        sizes = [len(parts), block, len(raw) % block, *map(len, parts)]
        head, body = np.array(sizes, count).tobytes(), b"".join(parts)
    if encoding == "raw":
        return head + body
    return base64.b64encode(head) + base64.b64encode(body)  # VTK encodes the header apart


@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("compressor", [None, "vtkZLibDataCompressor"])
@pytest.mark.parametrize("form", ["binary", "base64", "raw"])
def test_arrays_are_read_in_every_form_that_vtk_writes(header, order, compressor, form, tmp_path):
    points = np.random.default_rng(5).random((6, 3))
    arrays = {
        "Points": ("Float64", points),
        "connectivity": ("Int64", np.array([0, 1, 2, 2, 3, 4, 5, 1, 2, 3, 4])),
        "offsets": ("Int64", np.array([3, 7, 11])), "types": ("UInt8", np.array([5, 10, 10])),
    }  # fmt: skip
    sections, appended = {}, b""
    for name, (kind, values) in arrays.items():
        values = values.astype("u1") if kind == "UInt8" else values
        data = encoded(values, header, order, compressor, "raw" if form == "raw" else "base64")
        inline = form == "binary"
        sections[name] = (
            f'<DataArray type="{kind}" Name="{name}" NumberOfComponents='
            f'"{3 if name == "Points" else 1}" format="{"binary" if inline else "appended"}" '
            f'offset="{len(appended)}">{data.decode() if inline else ""}</DataArray>'
        )
        appended += b"" if inline else data
    text = HEAD.format(order="LittleEndian" if order == "<" else "BigEndian", header=header,
                       compressor=f' compressor="{compressor}"' if compressor else "")  # fmt: skip
    text += (f"<UnstructuredGrid><Piece><Points>{sections.pop('Points')}</Points>"
             f"<Cells>{''.join(sections.values())}</Cells></Piece></UnstructuredGrid>")  # fmt: skip
    raw = f'{text}<AppendedData encoding="{form}">_'.encode() + appended + b"</AppendedData>"
    path = tmp_path / "body.vtu"
    path.write_bytes((text.encode() if form == "binary" else raw) + b"</VTKFile>")
    found = read_vtk_xml(str(path))
    np.testing.assert_array_equal(found.points, points)
    assert [block.type for block in found.cells] == ["triangle", "tetra"]
    np.testing.assert_array_equal(found.cells[1].data, [[2, 3, 4, 5], [1, 2, 3, 4]])


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_bytes_are_read_whether_their_size_is_encoded_apart_or_not(count, apart, tmp_path):
    size, kinds = struct.pack("<I", count), bytes([1] * count)
    data = (base64.b64encode(size) + base64.b64encode(kinds) if apart
            else base64.b64encode(size + kinds)).decode()  # fmt: skip
    numbers = " ".join(map(str, range(1, count + 1)))
    array = '<DataArray type="{}" Name="{}" format="{}">{}</DataArray>'
    cells = "".join(array.format(*words) for words in (
        ("Int64", "connectivity", "ascii", "0 " * count), ("Int64", "offsets", "ascii", numbers),
        ("UInt8", "types", "binary", data)))  # fmt: skip
    points = array.format("Float64", "Points", "ascii", "0 0 0")
    path = tmp_path / "nodes.vtu"
    path.write_text(HEAD.format(order="LittleEndian", header="UInt32", compressor="")
                    + f"<UnstructuredGrid><Piece><Points>{points}</Points><Cells>{cells}</Cells>"
                    "</Piece></UnstructuredGrid></VTKFile>")  # fmt: skip
    assert read_vtk_xml(str(path)).cells[0].data.tolist() == [[0]] * count


def bomb(form: str) -> bytes:
    """A file of less than 1 MB whose points would take 400 MB."""
    text = HEAD.format(order="LittleEndian", header="UInt32",
                       compressor=' compressor="vtkZLibDataCompressor"')  # fmt: skip
    array = '<DataArray type="Float64" NumberOfComponents="3" format="{}" offset="0">{}</DataArray>'
    grid = "<UnstructuredGrid><Piece><Points>{}</Points></Piece></UnstructuredGrid>"
    if form == "one block":
        packed = zlib.compress(bytes(400_000_000), 1)
        head = struct.pack("<4I", 1, 400_000_000, 0, len(packed))
        data = base64.b64encode(head).decode() + base64.b64encode(packed).decode()
        return f"{text}{grid.format(array.format('binary', data))}</VTKFile>".encode()
    packed, count = zlib.compress(bytes(20_000)), 20_000
    data = struct.pack(f"<{3 + count}I", count, 20_000, 0, *[len(packed)] * count) + packed * count
    text += grid.format(array.format("appended", "")) + '<AppendedData encoding="raw">_'
    return text.encode() + data + b"</AppendedData></VTKFile>"


@pytest.mark.sampled
@pytest.mark.parametrize("form", ["one block", "many blocks"])
@pytest.mark.parametrize("read", [read_mesh_file, lambda p: read_solid_surface(p, notes=[])])
def test_a_file_that_unpacks_to_gigabytes_is_refused_before_they_are_there(form, read, tmp_path):
    path = tmp_path / "bomb.vtu"
    path.write_bytes(bomb(form))
    assert path.stat().st_size < 3_000_000
    with pytest.raises(MeshError, match=f"more than {MOST_UNPACKED / 1e6:.0f} MB"):
        read(path)


def test_many_arrays_of_the_same_bytes_are_bounded_together(tmp_path):
    data = base64.b64encode(struct.pack("<I", 1_000_000) + bytes(1_000_000)).decode()
    arrays = '<DataArray type="UInt8" Name="{}" format="appended" offset="0"/>'
    arrays = "".join(arrays.format(number) for number in range(1000))
    text = HEAD.format(order="LittleEndian", header="UInt32", compressor="")
    path = tmp_path / "body.vtu"
    path.write_text(f"{text}<UnstructuredGrid><Piece><Points>{arrays}</Points></Piece>"
                    f'</UnstructuredGrid><AppendedData encoding="base64">_{data}</AppendedData>'
                    "</VTKFile>")  # fmt: skip
    with pytest.raises(MeshError, match="more than 64 MB"):
        read_mesh_file(path)


def test_nested_entities_are_refused(tmp_path):
    path = tmp_path / "body.vtu"
    path.write_text('<?xml version="1.0"?><!DOCTYPE l [<!ENTITY a "aaaa">]><VTKFile>&a;</VTKFile>')
    with pytest.raises(MeshError, match="document type"):
        read_mesh_file(path)


@pytest.mark.parametrize(
    "name, text",
    [
        ("body.msh", "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n900000000\n1 0 0 0\n$EndNodes\n"),
        ("body.msh", "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4000000000\n$EndNodes\n"),
        ("body.vtk", "# vtk DataFile Version 4.2\nx\nBINARY\nDATASET UNSTRUCTURED_GRID\n"
         "POINTS 2000000000 double\n"),
    ],
)  # fmt: skip
def test_more_nodes_than_a_file_has_bytes_are_refused_before_memory_is_taken(name, text, tmp_path):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(MeshError, match="bytes, and states"):
        read_mesh_file(path)


@pytest.mark.parametrize("number", ["1e300", "-3e12", "1e9999"])
@pytest.mark.parametrize("suffix", [".stl", ".obj", ".vtk"])
def test_coordinates_that_would_overflow_are_refused(number, suffix, tmp_path):
    corners = [("0", "0", "0"), (number, "0", "0"), ("0", "1", "0"), ("0", "0", "1")]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    rows = [" ".join(corner) for corner in corners]
    path = tmp_path / f"part{suffix}"
    if suffix == ".stl":
        facets = "".join("facet normal 0 0 0\nouter loop\n"
                         + "".join(f"vertex {rows[corner]}\n" for corner in face)
                         + "endloop\nendfacet\n" for face in faces)  # fmt: skip
        path.write_text(f"solid part\n{facets}endsolid part\n")
    elif suffix == ".obj":
        path.write_text("".join(f"v {row}\n" for row in rows)
                        + "".join(f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces))  # fmt: skip
    else:
        points = np.array(corners, dtype=float)
        meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3]]))]).write(path, "vtk42")
        with pytest.raises(MeshError, match=r"node 1 is at .*(farther than|not finite)"):
            read_solid_mesh(path)
        return
    with pytest.raises(MeshError, match=r"point \d is at .*(farther than|not finite)"):
        read_solid_surface(path, notes=[])
