"""Files made to take memory, time or a traceback, and what each costs: python bench/hostile.py [KIND ...].

A row per file: its size, what heft makes of it, computing time and peak memory of the process that reads it and of its
parser. Exits with 1 where a traceback came, or a file took over 40 s or 1.5 GB.
"""

from __future__ import annotations

import json
import os
import struct
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer
from shared import head_table, show

MOST_S, MOST_MB = 40.0, 1500.0
Files = Iterator[tuple[str, bytes]]
READ = """\
import sys
from pathlib import Path
path = Path(sys.argv[1])
from testbed.errors import HeftError
try:
    if path.suffix == ".mcap":
        from testbed.importers.messages import open_messages
        log = open_messages(path)
        for topic in log.types:
            log.messages(topic)
    elif path.suffix == ".toml":
        from testbed.objects.files import load_object
        load_object(str(path))
    elif path.suffix == ".csv":
        from testbed.importers.columns import Columns, TimeMap
        from testbed.importers.tables import TableLog
        log = TableLog(path, Columns.model_construct())
        log.series("sensor", ["a", "b"], None, TimeMap(column="t"))
    else:
        from testbed.objects.conversion.surface import read_surface
        read_surface(path)
except HeftError as error:
    print("refused:", str(error).replace("\\n", " ")[-110:])
else:
    print("read")
"""


def logs() -> Files:
    """MCAP files."""

    def log(kind: str, encoding: str, definition: str, messages: list[bytes], **how: object) -> bytes:
        file = BytesIO()
        writer = Writer(file, **how)  # pyright: ignore[reportArgumentType]
        writer.start(profile="" if encoding == "jsonschema" else "ros2")
        schema = writer.register_schema(kind, encoding, definition.encode())
        channel = writer.register_channel("/a", "json" if encoding == "jsonschema" else "cdr", schema)
        for message in messages:
            writer.add_message(channel, 1, message, 1)
        writer.finish()
        return file.getvalue()

    def plain(*messages: bytes, **how: object) -> bytes:
        return log("a/msg/A", "jsonschema", "{}", list(messages), **how)

    def ros(definition: str) -> bytes:
        return log("a/msg/A", "ros2msg", definition, [bytes(64)])

    rule = f"\n{'=' * 80}\n"
    tree = rule.join(["a/B0 x", *(f"MSG: a/B{i}\nB{i + 1}[9] x" for i in range(40)), "MSG: a/B40\nuint8 x"])
    yield "brackets within brackets", ros(f"uint8 x = {'(' * 200}1{')' * 200}")
    yield "types within types, 9^40 items", ros(tree)
    yield "a type within itself", ros("a/A x")
    yield "array of 10^15 items", ros("uint8[1000000000000000] x")
    yield "a name that is code", log('a/msg/A"]=__import__("os")#', "ros2msg", "uint8 x", [bytes(9)])
    yield "definition of 30 MB", ros("uint8 x\n" * 4_000_000)
    yield "2 GB of zeros by zstd", plain(*[b"1" + bytes(2**20 - 1)] * 2000, chunk_size=2**26)
    yield "2 GB of spaces by lz4", plain(*[b" " * 2**20] * 2000, compression=CompressionType.LZ4, chunk_size=2**26)
    yield "JSON nested 100,000 deep", plain(b"[" * 100_000 + b"]" * 100_000)
    yield "a number of a million digits", plain(b'{"x": ' + b"9" * 1_000_000 + b"}")
    yield "a million empty messages", plain(*[b"{}"] * 1_000_000)
    yield "lengths beyond the file", plain(b"{}").replace(struct.pack("<Q", 0), struct.pack("<Q", 2**62), 3)


def glb(document: object, binary: bytes = b"") -> bytes:
    """A GLB of some JSON."""
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += bytes(-len(binary) % 4)
    parts = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<III", 0x46546C67, 2, 12 + len(parts)) + parts


def models() -> Files:
    """GLB files."""
    corners = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)

    def document(count: int = 3, nodes: Sequence[object] = (), **more: object) -> dict[str, object]:
        return {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes or [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36}],
        } | more

    doubled: list[dict[str, object]] = [{"children": [i + 1, i + 1]} for i in range(40)]
    wide = struct.pack(">IIBBBBB", 50_000, 50_000, 8, 2, 0, 0, 0)
    image = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in ((b"IHDR", wide), (b"IDAT", zlib.compress(bytes(2 * 10**8), 9)), (b"IEND", b""))
    )
    textured = {
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": len(image)}],
        "buffers": [{"byteLength": 36 + len(image)}],
        "images": [{"bufferView": 1, "mimeType": "image/png"}],
        "textures": [{"source": 0}],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    }

    def made(binary: bytes = corners, **changes: Any) -> bytes:
        return glb(document(**changes), binary)

    sparse = {"componentType": 5126, "count": 2**30, "type": "VEC3", "sparse": {"count": 1}}
    yield "2^31 corners", made(count=2**31)
    yield "an image of 50,000 x 50,000", made(corners + image, **textured)
    yield "nodes in a circle", made(nodes=[{"children": [1]}, {"mesh": 0, "children": [0]}])
    yield "2^40 copies of a mesh", made(nodes=[*doubled, {"mesh": 0}])
    yield "nodes 20,000 deep", made(nodes=[*({"children": [i + 1]} for i in range(20_000)), {"mesh": 0}])
    yield "a mesh in 300,000 nodes", made(nodes=[{"mesh": 0}] * 300_000, scenes=[{"nodes": [*range(300_000)]}])
    yield "sparse accessor of 2^30", made(accessors=[sparse])
    yield "JSON nested 100,000 deep", glb(b"[" * 100_000 + b"]" * 100_000)
    yield "corners at infinity", made(struct.pack("<9f", *[float("inf")] * 9))
    yield "lengths beyond the file", made()[:40]


def packages() -> Files:
    """3MF files."""
    head = '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" unit="millimeter">'
    mesh = (
        '<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="1" y="0" z="0"/><vertex x="0" y="1" z="0"/>'
        '</vertices><triangles><triangle v1="0" v2="1" v3="2"/></triangles></mesh>'
    )

    def package(model: str | bytes, extra: int = 0) -> bytes:
        file = BytesIO()
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("3D/3dmodel.model", model)
            for i in range(extra):
                archive.writestr(f"{i}", b"")
        return file.getvalue()

    def parts(objects: str, item: int, times: int = 1) -> bytes:
        build = f'<item objectid="{item}"/>' * times
        return package(f"{head}<resources>{objects}</resources><build>{build}</build></model>")

    def both(a: int, b: int) -> str:
        return f'<components><component objectid="{a}"/><component objectid="{b}"/></components>'

    one = f'<object id="1">{mesh}</object>'
    doubled = "".join(f'<object id="{i}">{both(i - 1, i - 1)}</object>' for i in range(2, 42))
    far = f"{head}<resources>{one}</resources></model>".replace('x="1"', f'x="1{"0" * 400}"')
    laughs = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10))
    yield "1 GB of zeros", package(bytes(2**30))
    yield "1 GB of text in a tag", package(head.encode() + b"<metadata>" + b"a" * 2**30)
    yield "a billion laughs", package(f'<!DOCTYPE a [<!ENTITY a0 "lol">{laughs}]>{head}&a9;</model>')
    yield "components in a circle", parts(f'<object id="1">{both(1, 1)}</object>', 1)
    yield "2^40 copies of a mesh", parts(one + doubled, 41)
    yield "an item a million times", parts(one, 1, 1_000_000)
    yield "tags 100,000 deep", package(head + "<a>" * 100_000)
    yield "100,000 files in it", package(head, 100_000)
    yield "a corner at 10^400", package(far)
    yield "corners that are not there", parts(one.replace('v3="2"', 'v3="2000000000"'), 1)
    yield "not even a zip", b"PK\x03\x04" + bytes(100)


def meshes(kind: str) -> Files:
    """PLY, OBJ and STL files."""
    ply = "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n{}end_header\n"
    face = "element face {}\nproperty list uint int vertex_indices\n"
    if kind == "ply":
        large = ply.format("binary_little_endian", 3, face.format(1)).encode() + bytes(36) + b"\xff" * 8
        yield "2^31 corners", ply.format("binary_little_endian", 2**31, "").encode() + bytes(36)
        yield "-1 corners", ply.format("ascii", -1, "").encode()
        yield "a face of 2^32 corners", large
        yield "10^9 faces, as text", ply.format("ascii", 3, face.format(10**9)).encode() + b"0 0 0\n" * 3
        yield "a million properties", ply.format("ascii", 1, "property float p\n" * 1_000_000).encode() + b"0 0 0\n"
        yield "a line of 100 MB", ply.format("ascii", 1, "comment " + "a" * 10**8 + "\n").encode()
    if kind == "obj":
        corners = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
        yield "a corner of 10^18", corners + b"f 1 2 1000000000000000000\n"
        yield "a face of a million corners", corners + b"f" + b" 1 2 3" * 333_333
        yield "10^6 materials", corners + b"".join(b"usemtl m%d\nf 1 2 3\n" % i for i in range(1_000_000))
        yield "a library of materials that is a device", b"mtllib /dev/zero\n" + corners + b"f 1 2 3\n"
        yield "numbers at 1e999", corners.replace(b"1", b"1e999") + b"f 1 2 3\n"
    if kind == "stl":
        yield "2^32 triangles", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50)
        yield "not a number", bytes(80) + struct.pack("<I", 1) + b"\xff" * 50
        yield "text that never ends", b"solid a\n" + b"facet normal 0 0 0\n" * 3_000_000


def objects() -> Files:
    """Object files."""
    blocks = 'name = "a"\n[blocks]\nlayout = ["1"]\nmass_kg = 0.1\n'
    yield "a key of 100,000 dots", ("a" + ".a" * 100_000 + " = 1\n").encode()
    yield "arrays 100,000 deep", ("a = " + "[" * 100_000 + "]" * 100_000).encode()
    yield "tables 100,000 deep", ("a = " + "{a=" * 100_000).encode()
    yield "a number of a million digits", f"{blocks}friction = {'9' * 1_000_000}\n".encode()
    yield "a million tables", "".join(f"[a{i}]\n" for i in range(1_000_000)).encode()
    yield "a header of 10,000 dots", ("[" + ".".join(["a"] * 10_000) + "]\n").encode() * 50
    yield "a layout of 10^6 rows", blocks.replace('["1"]', json.dumps(["1"] * 1_000_000)).encode()
    yield "a layout of 10^7 columns", blocks.replace('["1"]', json.dumps(["1" * 10**7])).encode()
    yield "a name of 100 MB", blocks.replace('"a"', '"' + "a" * 10**8 + '"').encode()
    yield "blocks of 10^-12 m", f"{blocks}size_m = 1e-12\n".encode()
    yield "masses that are not numbers", f"{blocks}friction = nan\n".encode()
    yield "not text", bytes(range(256)) * 1000


def tables() -> Files:
    """CSV files."""
    yield "a line of 100 MB", b"t,a,b\n" + b"1" * 10**8
    yield "a million columns", b"t,a,b" + b",c" * 1_000_000 + b"\n1,2,3\n"
    yield "a column a thousand times", b"t,a,b" + b",a" * 1000 + b"\n" + b"1,2,3\n" * 9
    yield "numbers at 1e999", b"t,a,b\n" + b"1,1e999,2\n" * 99
    yield "a quote that never ends", b't,a,b\n"' + b"1,2,3\n" * 3_000_000
    yield "zeros", bytes(10**7)
    yield "numbers of 100,000 digits", b"t,a,b\n" + (b"1," + b"9" * 100_000 + b",2\n") * 100
    yield "rows of different lengths", b"t,a,b\n" + b"1\n1,2,3,4,5,6\n" * 1000
    yield "time that stands", b"t,a,b\n" + b"1,2,3\n" * 1_000_000
    yield "no line at all", b""


KINDS: dict[str, tuple[str, Callable[[], Files]]] = {
    "mcap": (".mcap", logs),
    "glb": (".glb", models),
    "3mf": (".3mf", packages),
    **{kind: (f".{kind}", lambda kind=kind: meshes(kind)) for kind in ("ply", "obj", "stl")},
    "toml": (".toml", objects),
    "csv": (".csv", tables),
}


def cost(path: Path) -> tuple[str, float, float]:
    """Outcome of a file, computing time, s, and peak memory, MB."""
    said = path.with_suffix(".said")
    with said.open("wb") as out:
        child = os.posix_spawn(
            sys.executable,
            [sys.executable, "-c", READ, str(path)],
            os.environ | {"OMP_NUM_THREADS": "1"},
            file_actions=[(os.POSIX_SPAWN_DUP2, out.fileno(), 1), (os.POSIX_SPAWN_DUP2, out.fileno(), 2)],
        )
        code, used = os.wait4(child, 0)[1:]
    last = (said.read_text(errors="replace").strip().splitlines() or [""])[-1]
    outcome = last if not code else f"TRACEBACK: {last[:90]}"
    return outcome, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def write(folder: Path, kinds: list[str]) -> None:
    """Write the files of some kinds, in a process of its own: a child begins with the peak memory of its parent."""
    for kind in kinds:
        suffix, files = KINDS[kind]
        for index, (name, content) in enumerate(files()):
            (folder / f"{kind}_{index:02d}{suffix}").write_bytes(content)
            (folder / f"{kind}_{index:02d}.name").write_text(name, encoding="utf-8")


def main() -> None:
    kinds = sys.argv[1:] or list(KINDS)
    columns = ("kind", "file", "MB", "outcome", "s", "MB of memory")
    table = head_table(*columns, left=columns)
    costs: dict[str, list[tuple[str, float, float]]] = {kind: [] for kind in kinds}
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        writer = get_context("spawn").Process(target=write, args=(folder, kinds))
        writer.start()
        writer.join()
        for named in sorted(folder.glob("*.name")):
            kind, name = named.stem.partition("_")[0], named.read_text(encoding="utf-8")
            path = named.with_suffix(KINDS[kind][0])
            outcome, seconds, memory = cost(path)
            costs[kind].append((outcome, seconds, memory))
            size, outcome = f"{path.stat().st_size / 1e6:.3g}", outcome.replace(made, "")
            table.add_row(kind, name, size, outcome, f"{seconds:.1f}", f"{memory:.0f}")
            print(f"{kind} {name}: {outcome}, {seconds:.1f} s, {memory:.0f} MB", file=sys.stderr, flush=True)
    columns = ("kind", "files", "read", "refused", "traceback", "most s", "most MB")
    summary = head_table(*columns, left=columns)
    for kind, each in costs.items():
        counts = [sum(said.startswith(how) for said, _, _ in each) for how in ("read", "refused", "TRACEBACK")]
        most = [f"{max(values):.0f}" for values in ([c[1] for c in each], [c[2] for c in each])]
        summary.add_row(kind, str(len(each)), *map(str, counts), *most)
    show(table, summary, width=170)
    every = [cost for each in costs.values() for cost in each]
    sys.exit(any(said.startswith("TRACEBACK") or s > MOST_S or mb > MOST_MB for said, s, mb in every))


if __name__ == "__main__":
    main()
