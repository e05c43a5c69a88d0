#!/usr/bin/env python3
"""Prints the licences of the crates that a program is made of, each text once.

    third_party.py TARGET PACKAGE [FEATURES]

Needs cargo, and the sources of the crates, which a build has fetched.
"""

import collections
import json
import pathlib
import subprocess
import sys

NAMES = ("license", "licence", "copying", "copyright", "notice", "unlicense")
CODE = (".rs", ".c", ".h", ".py")
# Of libraries that are offered under two licences, the one that is not taken.
NOT_TAKEN = "GNU GENERAL PUBLIC LICENSE"


def output_of(*command):
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout


def main():
    target, package, *features = sys.argv[1:]
    tree = output_of("cargo", "tree", "--locked", "--package", package, "--target", target, "--edges", "normal",
                     "--features", ",".join(features), "--prefix", "none", "--format", "{p}")
    linked = {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    metadata = json.loads(output_of("cargo", "metadata", "--locked", "--format-version", "1"))
    crates = sorted(
        (crate for crate in metadata["packages"] if crate["source"] and (crate["name"], "v" + crate["version"]) in linked),
        key=lambda crate: (crate["name"], crate["version"]),
    )
    users = collections.defaultdict(list)
    print("Parts by others, with the licence that each offers. Their sources are in the public registry of Rust, by name and version.")
    print("The standard library of Rust: MIT OR Apache-2.0 (The Rust Project Developers)")
    if "musl" in target:
        print("musl: MIT (Rich Felker and others). LLVM's libunwind: Apache-2.0 WITH LLVM-exception (LLVM contributors)")
    print()
    for crate in crates:
        title = f"{crate['name']} {crate['version']}"
        print(f"{title}: {crate['license'] or 'see its text below'} ({', '.join(crate['authors']) or 'its authors'})")
        folder = pathlib.Path(crate["manifest_path"]).parent
        # Libraries in C lie one folder deeper: zstd/LICENSE, liblz4/lib/LICENSE.
        for file in sorted([*folder.glob("*"), *folder.glob("*/*"), *folder.glob("*/lib/*")]):
            if file.is_file() and file.name.lower().startswith(NAMES) and file.suffix not in CODE:
                text = file.read_text(errors="replace").strip()
                if not text.startswith(NOT_TAKEN):
                    users[text].append(title)
    for text, titles in users.items():
        print(f"\n{'=' * 100}\n{', '.join(dict.fromkeys(titles))}\n{'=' * 100}\n{text}")


main()
