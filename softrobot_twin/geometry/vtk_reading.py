"""Reading of VTK files: XML (.vtu, .vtp), whose arrays may be compressed, and legacy (.vtk).

A compressed array of a few bytes can stand for gigabytes. Each array is unpacked only as far as all
arrays together remain below `MOST_UNPACKED`. meshio has no such bound, and reads no POLYDATA; of a
grid in several pieces meshio keeps only the cells of the last one.
"""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import meshio
import meshio.vtk
import numpy as np

MOST_UNPACKED = 64_000_000
"""Greatest number of bytes of all arrays of a file together."""

_TYPES = {"Float32": "f4", "Float64": "f8", "Int8": "i1", "Int16": "i2", "Int32": "i4",
          "Int64": "i8", "UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8"}  # fmt: skip
# VTK's number of each kind of cell, as meshio names it, and its number of nodes.
_CELLS = {1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4), 10: ("tetra", 4),
          12: ("hexahedron", 8), 13: ("wedge", 6), 14: ("pyramid", 5), 21: ("line3", 3),
          22: ("triangle6", 6), 23: ("quad8", 8), 24: ("tetra10", 10), 25: ("hexahedron20", 20),
          26: ("wedge15", 15), 27: ("pyramid13", 13), 28: ("quad9", 9),
          29: ("hexahedron27", 27)}  # fmt: skip
_POLYGON = 7
# Numbers in legacy files of polygons; they are big-endian.
_LEGACY_TYPES = {b"float": ">f4", b"double": ">f8", b"int": ">i4", b"long": ">i8",
                 b"vtktypeint32": ">i4", b"vtktypeint64": ">i8", b"vtkidtype": ">i4"}  # fmt: skip
_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lambda: lzma.LZMADecompressor(memlimit=MOST_UNPACKED),
}


def read_vtk_xml(path: str) -> meshio.Mesh:
    """Reads nodes, cells and the numbers of cells of an unstructured grid or of polygons.

    Args:
        path: File to read: its arrays as text, base64 or raw, compressed by zlib, LZMA or not.

    Returns:
        The content, one block of cells for each kind of cell, in the order of VTK's numbers;
        polygons of each number of corners are a block.

    Raises:
        ValueError: The file is neither, is damaged, or unpacks to more than `MOST_UNPACKED`.
    """
    return _XmlFile(Path(path).read_bytes()).content()


def read_legacy_vtk(path: str) -> meshio.Mesh:
    """Reads a legacy file: POLYDATA here, all else by meshio.

    Args:
        path: File to read, as text or binary.

    Returns:
        The content.

    Raises:
        Exception: The file is damaged, or its polygons are stored as strips.
    """
    raw = Path(path).read_bytes()
    if re.search(rb"^\s*DATASET\s+POLYDATA", raw[:2048], re.M | re.I) is None:
        return meshio.vtk.read(path)
    is_text = re.search(rb"^\s*ASCII\s*$", raw[:2048], re.M | re.I) is not None

    def section(words: bytes, start: int = 0) -> re.Match[bytes]:
        found = re.compile(rb"^\s*" + words + rb"[^\n]*\n", re.M | re.I).search(raw, start)
        if found is None:
            raise ValueError(f"it has no {words.split(bytes([92]))[0].decode()}")
        return found

    def numbers(start: int, count: int, kind: str) -> np.ndarray:
        if not is_text:
            return np.frombuffer(raw, kind, count, start).astype(kind[1:])
        found = raw[start:].split(None, count)[:count]
        if len(found) < count:
            raise ValueError(f"it ends before {count} numbers")
        return np.array(found).astype(kind[1:])

    if re.search(rb"^\s*TRIANGLE_STRIPS\s", raw, re.M | re.I):
        raise ValueError("it has strips of triangles, which are not read; write polygons")
    head = section(rb"POINTS\s+(\d+)\s+(\w+)")
    points = numbers(head.end(), 3 * int(head[1]), _LEGACY_TYPES[head[2].lower()])
    head = section(rb"POLYGONS\s+(\d+)\s+(\d+)", head.end())
    count, size = int(head[1]), int(head[2])
    if re.match(rb"\s*OFFSETS", raw[head.end() :], re.I):  # version 5
        ends = section(rb"OFFSETS\s+(\w+)", head.start())
        nodes = section(rb"CONNECTIVITY\s+(\w+)", ends.end())
        ends = numbers(ends.end(), count, _LEGACY_TYPES[ends[1].lower()])[1:]
        nodes = numbers(nodes.end(), size, _LEGACY_TYPES[nodes[1].lower()])
    else:  # each polygon begins with its number of corners
        rows, starts = numbers(head.end(), size, ">i4"), [0]
        for _ in range(count):
            starts.append(starts[-1] + 1 + max(0, int(rows[starts[-1]])))
        nodes, ends = np.delete(rows, starts[:-1]), np.array(starts[1:]) - np.arange(1, count + 1)
    if len(ends) and ends[-1] > len(nodes):
        raise ValueError("its polygons have more corners than it states")
    rows = _rows(np.full(len(ends), _POLYGON), nodes.astype(np.int64), ends.astype(np.int64))
    return meshio.Mesh(points.reshape(-1, 3), [(_name(kind), own) for kind, _, own in rows])


class _XmlFile:
    """A file, and how much of it may still be unpacked."""

    def __init__(self, text: bytes):
        if b"<!DOCTYPE" in text[:4096]:
            raise ValueError("it has a document type, which VTK does not write")
        self._appended: bytes | str | None = None
        opening = re.search(rb'<AppendedData[^>]*encoding="raw"[^>]*>', text)
        if opening is not None:  # Raw data in it is no XML.
            end = text.rfind(b"</AppendedData>")
            self._appended = text[opening.end() : end].partition(b"_")[2]
            text = text[: opening.end()] + text[end:]
        root = ElementTree.fromstring(text)
        self._has_polygons = root.find("PolyData") is not None
        grid = root.find("PolyData" if self._has_polygons else "UnstructuredGrid")
        if root.tag != "VTKFile" or grid is None:
            raise ValueError("it is no UnstructuredGrid and no PolyData")
        self._pieces = grid.findall("Piece")
        if not self._pieces:
            raise ValueError("it has no Piece")
        compressor = root.get("compressor")
        if compressor is not None and compressor not in _DECOMPRESSORS:
            raise ValueError(f"its compressor is {compressor}; {', '.join(_DECOMPRESSORS)} are read")
        self._decompressor = None if compressor is None else _DECOMPRESSORS[compressor]
        self._order = ">" if root.get("byte_order") == "BigEndian" else "<"
        self._counts = self._type(root.get("header_type", "UInt32"))
        if self._appended is None:
            self._appended = (root.findtext("AppendedData") or "").strip().removeprefix("_")
        self._left = MOST_UNPACKED

    def content(self) -> meshio.Mesh:
        points, rows, numbers = [], dict[tuple, list[np.ndarray]](), dict[str, dict[tuple, list]]()
        first = 0
        for piece in self._pieces:
            places = self._arrays(piece, "Points")
            if len(places) != 1:
                raise ValueError("a Piece has no Points")
            points.append(next(iter(places.values())).reshape(-1, 3))
            if int(piece.get("NumberOfStrips") or 0):
                raise ValueError("it has strips of triangles, which are not read; write polygons")
            cells = self._arrays(piece, "Polys" if self._has_polygons else "Cells")
            if self._has_polygons:
                cells["types"] = np.full(len(cells.get("offsets", ())), _POLYGON)
            if not {"connectivity", "offsets", "types"} <= cells.keys():
                raise ValueError("Cells need connectivity, offsets and types")
            nodes, ends = (cells[name].ravel().astype(np.int64)
                           for name in ("connectivity", "offsets"))  # fmt: skip
            types = cells["types"].ravel().astype(np.int64)
            of_cells = {} if self._has_polygons else self._arrays(piece, "CellData")
            if len(ends) != len(types):
                raise ValueError("it has not as many offsets as types of cells")
            for kind, own, corners in _rows(types, nodes, ends):
                rows.setdefault(kind, []).append(first + corners)
                for name, values in of_cells.items():
                    if len(values) == len(types):
                        numbers.setdefault(name, {}).setdefault(kind, []).append(values[own])
            first += len(points[-1])
        kinds = sorted(rows)
        return meshio.Mesh(
            np.concatenate(points),
            [(_name(kind), np.concatenate(rows[kind])) for kind in kinds],
            cell_data={name: [np.concatenate(found[kind]) for kind in kinds]
                       for name, found in numbers.items() if sorted(found) == kinds},
        )  # fmt: skip

    def _arrays(self, piece: ElementTree.Element, section: str) -> dict[str, np.ndarray]:
        """The arrays of a section by their names, those of several components as rows."""
        found = {}
        for array in piece.findall(f"{section}/DataArray"):
            if array.get("type") not in _TYPES:
                continue  # words
            values = self._values(array)
            components = int(array.get("NumberOfComponents") or 1)
            found[array.get("Name", section)] = (
                values if components == 1 else values.reshape(-1, components)
            )
        return found

    def _type(self, name: str | None) -> np.dtype:
        if name not in _TYPES:
            raise ValueError(f"an array has the type {name}")
        return np.dtype(self._order + _TYPES[name])

    def _values(self, array: ElementTree.Element) -> np.ndarray:
        kind = self._type(array.get("type"))
        form = array.get("format", "ascii")
        if form == "ascii":
            text = array.text or ""
            self._take(len(text) // 2 * kind.itemsize)
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # of words that are no numbers
                return np.fromstring(text, dtype=kind.newbyteorder("="), sep=" ")
        if form == "binary":
            return np.frombuffer(self._unpacked(_Bytes((array.text or "").strip())), kind)
        if form != "appended":
            raise ValueError(f"an array has the format {form}")
        start = int(array.get("offset", "0"))
        if start < 0:
            raise ValueError("an array begins before the appended data")
        return np.frombuffer(self._unpacked(_Bytes(self._appended, start)), kind)

    def _unpacked(self, source: _Bytes) -> bytes:
        """The bytes of an array: its size, or count and sizes of its compressed blocks, come first."""
        width = self._counts.itemsize
        first = int(np.frombuffer(source.take(0, width), self._counts)[0])
        if self._decompressor is None:
            self._take(first)
            return source.whole(width, first)
        head_size = (3 + first) * width
        sizes = np.frombuffer(source.take(0, head_size), self._counts)[3:].astype(np.int64)
        blocks, start = [], 0
        packed = source.after(head_size, int(sizes.sum()))
        for size in sizes.tolist():
            part = packed[start : start + size]
            blocks.append(self._decompressor().decompress(part, self._left + 1))
            self._take(len(blocks[-1]))
            start += size
        return b"".join(blocks)

    def _take(self, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise ValueError(f"its arrays unpack to more than {MOST_UNPACKED / 1e6:.0f} MB")


class _Bytes(NamedTuple):
    """Bytes of raw data or of base64 text from a start on."""

    data: bytes | str
    start: int = 0

    def length(self, size: int) -> int:
        """Length of so many bytes in the data."""
        return 4 * -(-size // 3) if isinstance(self.data, str) else size

    def take(self, start: int, size: int) -> bytes:
        first = self.start + start
        end = first + self.length(size)
        if size < 0 or end > len(self.data):
            raise ValueError("an array ends before its last byte")
        try:
            part = self.data[first:end]
            return base64.b64decode(part)[:size] if isinstance(part, str) else part
        except binascii.Error as error:
            raise ValueError(f"an array is no base64 ({error})") from None

    def after(self, header_size: int, size: int) -> bytes:
        return self.take(self.length(header_size), size)

    def whole(self, header_size: int, size: int) -> bytes:
        """An array without compression, encoded with its header or, as the padding shows, apart."""
        header = self.data[self.start : self.start + self.length(header_size)]
        if isinstance(header, bytes) or header.endswith("=" * (-header_size % 3)):
            return self.after(header_size, size)
        return self.take(0, header_size + size)[header_size:]


def _rows(
    types: np.ndarray, nodes: np.ndarray, ends: np.ndarray
) -> list[tuple[tuple[int, int], np.ndarray, np.ndarray]]:
    """Kind and width, numbers, and nodes of the cells of each kind, polygons by their width."""
    widths = np.diff(ends, prepend=0)
    if (widths < 0).any() or (len(ends) and ends[-1] > len(nodes)):
        raise ValueError("the offsets of its cells do not fit its connectivity")
    rows = []
    for kind, width in sorted(set(zip(types.tolist(), widths.tolist(), strict=True))):
        known = width if kind == _POLYGON else _CELLS.get(kind, ("", 0))[1]
        if width == 0 or width != known:
            what = f"cells of VTK's type {kind}"
            raise ValueError(f"its {what} have other than {known} nodes" if known
                             else f"it has {what}, which are not read")  # fmt: skip
        own = np.flatnonzero((types == kind) & (widths == width))
        rows.append(((kind, width), own, nodes[(ends[own] - width)[:, None] + np.arange(width)]))
    return rows


def _name(kind: tuple[int, int]) -> str:
    if kind[0] == _POLYGON:
        return {3: "triangle", 4: "quad"}.get(kind[1], "polygon")
    return _CELLS[kind[0]][0]
