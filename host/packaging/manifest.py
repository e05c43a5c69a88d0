#!/usr/bin/env python3
"""Writes SHA256SUMS and manifest.json for a folder of packages: manifest.py FOLDER VERSION

For programs it states the version of glibc that they need, and refuses a static one that needs any.
"""

import hashlib
import json
import pathlib
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile

PROTOCOL = re.compile(r"PROTOCOL: ProtocolVersion = ProtocolVersion \{ major: (\d+), minor: (\d+) \}")


def output_of(*command):
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


def glibc_needed(program):
    """The newest version of glibc whose symbols `program` (bytes of an ELF file) uses; None for a static one."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(program)
        file.flush()
        if "(NEEDED)" not in output_of("readelf", "--dynamic", file.name):
            return None
        symbols = output_of("readelf", "--version-info", "--wide", file.name)
    versions = re.findall(r"GLIBC_(\d+)\.(\d+)", symbols)
    return "{}.{}".format(*max((int(major), int(minor)) for major, minor in versions))


def program_in(path):
    """The program or the Python module in a package."""
    if path.name.endswith(".deb"):
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run(["dpkg-deb", "--extract", path, folder], check=True)
            return pathlib.Path(folder, "usr/bin/slitpose").read_bytes()
    if path.name.endswith(".tar.gz"):
        with tarfile.open(path) as archive:
            return next(archive.extractfile(it).read() for it in archive if it.name.endswith("/bin/slitpose"))
    with zipfile.ZipFile(path) as archive:
        return next(archive.read(name) for name in archive.namelist() if name.endswith(".so"))


def entry(path, protocol):
    content = path.read_bytes()
    it = {"file": path.name, "size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
    if path.name.endswith((".deb", ".tar.gz", ".whl")):
        it["glibc"] = glibc_needed(program_in(path))
        if path.name.endswith(".tar.gz") and it["glibc"]:
            raise SystemExit(f"manifest: the program in {path.name} is not static: it needs glibc {it['glibc']}")
    if path.name.endswith((".elf", ".bin", ".dfu")):
        it |= {"board": "STM32G474RE", "protocol": protocol, "solves_poses": "-pose-" in path.name}
    return it


def main():
    folder, version = pathlib.Path(sys.argv[1]), sys.argv[2]
    root = pathlib.Path(__file__).resolve().parents[2]
    protocol = ".".join(PROTOCOL.search((root / "protocol/src/lib.rs").read_text()).groups())
    changed = output_of("git", "-C", str(root), "status", "--porcelain")
    files = [entry(path, protocol) for path in sorted(folder.glob("slitpose[-_]*"))]
    manifest = {
        "version": version,
        "commit": output_of("git", "-C", str(root), "rev-parse", "HEAD"),
        "uncommitted_changes": bool(changed),
        "protocol": protocol,
        "files": files,
    }
    (folder / "manifest.json").write_text(json.dumps(manifest, indent=2) + "\n")
    (folder / "SHA256SUMS").write_text("".join(f"{it['sha256']}  {it['file']}\n" for it in files))


main()
