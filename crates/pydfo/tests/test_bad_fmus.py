"""Invalid and malicious FMU files: each raises a typed error with names and numbers, and leaves no files behind."""

from __future__ import annotations

import gc
import shutil
import stat
import struct
import subprocess
import sys
import zipfile
import zlib

import fmus
import pytest

import pydfo
from pydfo import FMUModel, FmuError, example_fmu, read_description


@pytest.fixture(autouse=True)
def unpacked(tmp_path_factory, monkeypatch):
    """Returns the folder for temporary files, which must be empty at the end of every test."""
    folder = tmp_path_factory.mktemp("unpacked")
    monkeypatch.setenv("TMPDIR", str(folder))
    yield folder
    gc.collect()  # exceptions hold references to the models that raised them
    pydfo._core.close_unused()
    assert list(folder.iterdir()) == []


def refused(path, *parts):
    """Checks that opening fails with a FmuError that contains all of `parts`."""
    for load in (FMUModel, pydfo.load_fmu, read_description):
        with pytest.raises(FmuError) as info:
            load(path)
        for part in parts:
            assert part in str(info.value)
    return str(info.value)


def refused_when_loaded(path, *parts):
    """Checks that a simulation fails with a FmuError that contains `parts`, because contents are checked when
    unpacked."""
    with pytest.raises(FmuError) as info:
        FMUModel(path).simulate(final_time=1)
    for part in parts:
        assert part in str(info.value)


# --- no archive
# -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", [b"", b"no zip", b"PK\x03\x04", bytes(100_000)], ids=["empty", "text", "start", "zeros"])
def test_file_that_is_not_a_zip_is_rejected(tmp_path, content):
    (tmp_path / "m.fmu").write_bytes(content)
    refused(tmp_path / "m.fmu", "m.fmu", "archive")


def test_archive_without_model_description_is_rejected(tmp_path):
    refused(fmus.write(tmp_path / "m.fmu", None, {"readme.txt": "x"}), "m.fmu", "no modelDescription.xml")
    refused(fmus.write(tmp_path / "n.fmu", None, {"M/modelDescription.xml": fmus.xml()}), "modelDescription.xml", "M")
    (tmp_path / "folder").mkdir()
    refused(tmp_path / "folder", "no modelDescription.xml")


@pytest.mark.parametrize("part", [0.05, 0.3, 0.6, 0.9, 0.99, 0.9999])
def test_truncated_archive_is_rejected(tmp_path, part):
    whole = example_fmu("dahlquist").read_bytes()
    (tmp_path / "m.fmu").write_bytes(whole[: int(part * len(whole))])
    refused(tmp_path / "m.fmu", "m.fmu")


def test_unreadable_file_is_rejected(tmp_path):
    with pytest.raises(OSError) as info:
        FMUModel(tmp_path / "m.fmu" / "x" / "y.fmu")
    assert info.value.filename
    (tmp_path / "f").write_text("x")
    with pytest.raises(FileNotFoundError if sys.platform == "win32" else NotADirectoryError):
        FMUModel(tmp_path / "f" / "m.fmu")
    with pytest.raises((OSError, ValueError)):
        FMUModel("m\0.fmu")


# --- malicious archives
# -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "../evil.txt",
        "resources/../../evil.txt",
        "..",
        "/etc/evil.txt",
        "C:/evil.txt",
        "..\\evil.txt",
        "C:\\evil.txt",
        "a/" * 200 + "evil.txt",
        "e" * 300,
        "evil\n.txt",
    ],
)
def test_names_outside_the_archive_are_rejected(tmp_path, name):
    path = tmp_path / "m.fmu"
    entries = [Entry("modelDescription.xml", fmus.xml().encode()), Entry(name, b"evil")]
    path.write_bytes(archive(entries))
    refused(path, "m.fmu", "entry")
    assert not (tmp_path / "evil.txt").exists() and not (tmp_path.parent / "evil.txt").exists()


def test_names_with_backslashes_and_dots_match_info_zip(tmp_path):
    path = tmp_path / "m.fmu"
    names = ["resources\\a.txt", "resources//b.txt", "./resources/c.txt"]
    path.write_bytes(archive([Entry(".\\modelDescription.xml", fmus.xml().encode()), *(Entry(name, b"x") for name in names)]))
    assert read_description(path).model_name


@pytest.mark.parametrize(
    ("names", "part"),
    [
        (("a.txt", "a.txt"), "occurs twice"),
        (("a.txt", "A.TXT"), "upper and lower case"),
        (("Folder/a.txt", "folder/b.txt"), "upper and lower case"),
        (("modelDescription.xml",), "occurs twice"),
        (("a", "a/b"), "folder"),
    ],
)
def test_colliding_names_are_rejected(tmp_path, names, part):
    path = tmp_path / "m.fmu"
    path.write_bytes(archive([Entry("modelDescription.xml", fmus.xml().encode()), *(Entry(n, b"x%d" % i) for i, n in enumerate(names))]))
    refused(path, part)


@pytest.mark.parametrize("kind", [stat.S_IFLNK, stat.S_IFIFO, stat.S_IFCHR, stat.S_IFSOCK])
def test_links_and_devices_are_rejected(tmp_path, kind):
    path = tmp_path / "m.fmu"
    link = Entry("resources/link", b"/etc/passwd", mode=kind | 0o777)
    path.write_bytes(archive([Entry("modelDescription.xml", fmus.xml().encode()), link]))
    refused(path, "resources/link", "not a file")


def bomb():
    """Returns 10 MB that inflate to 10 GiB of zeros."""
    block = zlib.compressobj(9, zlib.DEFLATED, -15)
    piece = block.compress(bytes(16 << 20)) + block.flush(zlib.Z_FULL_FLUSH)
    stream = piece * 640 + b"\x03\x00"
    assert 5e6 < len(stream) < 20e6
    return stream


@pytest.mark.parametrize("declared", [10 << 30, 1 << 30, 1 << 20, 0])
def test_zip_bomb_is_rejected(tmp_path, declared):
    path = tmp_path / "m.fmu"
    entry = Entry("resources/bomb", packed=bomb(), size=declared)
    path.write_bytes(archive([Entry("modelDescription.xml", fmus.xml().encode()), entry]))
    refused_when_loaded(path, "resources/bomb")


def test_overlapping_entries_are_rejected(tmp_path):
    path = tmp_path / "m.fmu"
    description = Entry("modelDescription.xml", fmus.xml().encode())
    # Both directory entries point to the same bytes.
    path.write_bytes(archive([description, Entry("a", b"shared"), Entry("a", b"shared", directory_name="b", header_of=1)]))
    refused_when_loaded(path, '"b"')
    # The data of the first entry overlap the second entry.
    second = Entry("b", b"x" * 50)
    reach = Entry("a", b"y" * 10, size=10 + len(second.local()), packed_size=10 + len(second.local()))
    path.write_bytes(archive([description, reach, second]))
    with pytest.raises(pydfo.FmuError, match="shares bytes"):
        read_description(path)


@pytest.mark.parametrize("size", [0, 5, 99, 101, 10**6, 2**31, 2**40])
@pytest.mark.parametrize("deflated", [True, False])
def test_false_sizes_are_rejected(tmp_path, size, deflated):
    path = tmp_path / "m.fmu"
    content = bytes(range(100))
    packed = deflate(content) if deflated else None
    entry = Entry("resources/lie", content, packed=packed, size=size)
    path.write_bytes(archive([Entry("modelDescription.xml", fmus.xml().encode()), entry]))
    refused_when_loaded(path, "resources/lie")


def test_damaged_data_are_rejected(tmp_path):
    path = tmp_path / "m.fmu"
    description = Entry("modelDescription.xml", fmus.xml().encode())
    path.write_bytes(archive([description, Entry("a", b"abc", crc=1)]))
    refused_when_loaded(path, '"a"', "damaged")
    path.write_bytes(archive([description, Entry("a", packed=b"\xff" * 20, size=20)]))
    refused_when_loaded(path, '"a"', "damaged")


def test_encrypted_entry_is_rejected(tmp_path):
    path = tmp_path / "m.fmu"
    path.write_bytes(archive([Entry("modelDescription.xml", fmus.xml().encode()), Entry("a", b"abc", flags=1)]))
    refused(path, '"a"', "encrypted")


# --- model descriptions -----------------------------------------------------------------------------------------------

LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {chr(98 + k)} "{f"&{chr(97 + k)};" * 10}">' for k in range(9))
    + ']><fmiModelDescription fmiVersion="2.0" modelName="&j;" guid="g"/>'
)
FILE = '<?xml version="1.0"?><!DOCTYPE f [<!ENTITY x SYSTEM "file:///etc/passwd">]><fmiModelDescription fmiVersion="2.0" modelName="&x;" guid="g"/>'


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", []),
        ("no XML", []),
        ("<a/>", ["fmiModelDescription"]),
        (LAUGHS, ["line 1"]),
        (FILE, ["line 1"]),
        (fmus.xml("<a>" * 1000 + "</a>" * 1000), ["more than", "levels deep"]),
        (fmus.xml()[:-30], ["line"]),
        (fmus.xml().replace('fmiVersion="2.0"', 'fmiVersion="4.0"'), ["4.0"]),
        (fmus.xml().replace('fmiVersion="2.0"', ""), ["fmiVersion"]),
        (fmus.xml(interface='<ModelExchange modelIdentifier="../evil"/>'), ["../evil"]),
        (fmus.xml(interface='<ModelExchange modelIdentifier="a/b"/>'), ["a/b"]),
        (fmus.xml(interface='<ModelExchange modelIdentifier="a\\b"/>'), ["a\\"]),
        (fmus.xml(interface='<ModelExchange modelIdentifier=""/>'), []),
        (fmus.xml(interface=""), []),
        (fmus.xml(structure='<Derivatives><Unknown index="5"/></Derivatives>'), []),
    ],
    ids=[
        "empty",
        "text",
        "another root",
        "entity bomb",
        "external entity",
        "1000 deep",
        "truncated",
        "version 4",
        "no version",
        "identifier with ..",
        "identifier with /",
        "identifier with backslash",
        "no identifier",
        "no interface",
        "index out of range",
    ],
)
def test_bad_model_descriptions_are_rejected(tmp_path, text, parts):
    path = fmus.write(tmp_path / "m.fmu", text)
    with pytest.raises(FmuError) as info:
        FMUModel(path).simulate(final_time=1)
    for part in parts:
        assert part in str(info.value)


def test_bad_utf_8_is_read_and_reported(tmp_path):
    text = fmus.xml(head='author="M\u00fcller"').encode("latin-1")
    d = read_description(fmus.write(tmp_path / "m.fmu", text))
    assert d.author.startswith("M") and d.author.endswith("ller")
    assert [quirk.kind for quirk in d.quirks] == ["encoding"]
    declared = fmus.xml(head='author="M\u00fcller"', declaration='<?xml version="1.0" encoding="ISO-8859-1"?>')
    assert read_description(fmus.write(tmp_path / "n.fmu", declared.encode("latin-1"))).author == "M\u00fcller"


# --- libraries --------------------------------------------------------------------------------------------------------


def test_missing_binary_for_this_platform_is_reported(tmp_path):
    files = {"binaries/darwin64/m.dylib": "x", "binaries/riscv128-plan9/m.so": "x", "resources/data.txt": "x"}
    model = FMUModel(fmus.write(tmp_path / "m.fmu", fmus.xml(), files))
    with pytest.raises(FmuError) as info:
        model.simulate(final_time=1)
    for part in ("m.fmu", "no binary", "darwin64", "riscv128-plan9"):
        assert part in str(info.value)


def platform_folder():
    """Returns the folder in ``binaries/`` used by packing on this platform."""
    with zipfile.ZipFile(example_fmu("dahlquist")) as packed:
        (name,) = (n for n in packed.namelist() if n.startswith("binaries/") and not n.endswith("/"))
    return name.split("/")[1], name.rpartition(".")[2]


def test_invalid_library_is_rejected(tmp_path):
    folder, suffix = platform_folder()
    model = FMUModel(fmus.write(tmp_path / "m.fmu", fmus.xml(), {f"binaries/{folder}/m.{suffix}": "not a library"}))
    with pytest.raises(FmuError):
        model.simulate(final_time=1)


def test_library_without_mandatory_function_is_rejected(tmp_path):
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler")
    folder, suffix = platform_folder()
    (tmp_path / "m.c").write_text(
        'const char *fmi2GetVersion(void) { return "2.0"; }\nconst char *fmi2GetTypesPlatform(void) { return "default"; }\n'
    )
    library = tmp_path / f"m.{suffix}"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, tmp_path / "m.c"], check=True)
    files = {f"binaries/{folder}/m.{suffix}": library.read_bytes()}
    model = FMUModel(fmus.write(tmp_path / "m.fmu", fmus.xml(), files))
    with pytest.raises(FmuError, match="export the function fmi2"):
        model.simulate(final_time=1)


def test_compiler_errors_are_reported(tmp_path):
    interface = '<ModelExchange modelIdentifier="m"><SourceFiles><File name="m.c"/></SourceFiles></ModelExchange>'
    model = FMUModel(fmus.write(tmp_path / "m.fmu", fmus.xml(interface=interface), {"sources/m.c": "int x = ;"}))
    with pytest.raises(FmuError, match="m.c"):
        model.simulate(final_time=1)


# --- zip archives byte by byte
# ----------------------------------------------------------------------------------------


def deflate(content):
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return packer.compress(content) + packer.flush()


class Entry:
    """An entry of an archive in which every field can be falsified."""

    def __init__(
        self, name, content=b"", *, packed=None, size=None, packed_size=None, crc=None, mode=stat.S_IFREG | 0o644,
        flags=0, directory_name=None, header_of=None,
    ):  # fmt: skip
        self.name = name.encode()
        self.directory_name = self.name if directory_name is None else directory_name.encode()
        self.method = 0 if packed is None else 8
        self.packed = content if packed is None else packed
        self.size = len(content) if size is None else size
        self.packed_size = len(self.packed) if packed_size is None else packed_size
        self.crc = zlib.crc32(content) if crc is None else crc
        self.mode, self.flags, self.header_of = mode, flags, header_of

    def sizes(self):
        return min(self.packed_size, 2**32 - 1), min(self.size, 2**32 - 1)

    def local(self):
        head = struct.pack("<HHHHHLLLHH", 20, self.flags, self.method, 0, 33, self.crc, *self.sizes(), len(self.name), 0)
        return b"PK\x03\x04" + head + self.name + self.packed

    def central(self, offset):
        extra = struct.pack("<HHQ", 1, 8, self.size) if self.size >= 2**32 - 1 else b""
        head = struct.pack(
            "<HHHHHHLLLHHHHHLL",
            20 | 3 << 8, 20, self.flags, self.method, 0, 33, self.crc, *self.sizes(), len(self.directory_name), len(extra),
            0, 0, 0, self.mode << 16, offset,
        )  # fmt: skip
        return b"PK\x01\x02" + head + self.directory_name + extra


def archive(entries):
    """Builds an archive of the entries, byte by byte."""
    body, offsets = b"", []
    for entry in entries:
        offsets.append(len(body))
        if entry.header_of is None:
            body += entry.local()
    shown = [offset if e.header_of is None else offsets[e.header_of] for e, offset in zip(entries, offsets)]
    directory = b"".join(entry.central(offset) for entry, offset in zip(entries, shown))
    count = len(entries)
    return body + directory + struct.pack("<4sHHHHLLH", b"PK\x05\x06", 0, 0, count, count, len(directory), len(body), 0)


def test_handmade_archive_is_valid_without_falsified_fields(tmp_path):
    path = tmp_path / "m.fmu"
    entries = [Entry("modelDescription.xml", fmus.xml().encode()), Entry("a", b"abc"), Entry("b", b"a", packed=deflate(b"a"))]
    path.write_bytes(archive(entries))
    with zipfile.ZipFile(path) as z:
        assert z.testzip() is None
    assert read_description(path).model_name == "M"
