//! The C header as programs find it once it is installed, with every compiler there is.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use tempfile::TempDir;

fn host(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn install(prefix: &str, destination: &str) -> Output {
    let mut command = Command::new(host("include/install"));
    command.env("PREFIX", prefix).env("DESTDIR", destination).output().unwrap()
}

/// The output of a shell command that finds the package under `prefix`.
fn shell(prefix: &str, command: &str) -> String {
    let path = format!("{prefix}/share/pkgconfig");
    let output = Command::new("sh").args(["-c", command]).env("PKG_CONFIG_PATH", path).output().unwrap();
    assert!(output.status.success(), "`{command}` (needs cc and pkg-config): {output:?}");
    String::from_utf8(output.stdout).unwrap().trim().to_owned()
}

#[test]
fn a_program_finds_the_installed_header_by_pkg_config() {
    let folder = TempDir::new().unwrap();
    let prefix = folder.path().join("prefix").to_str().unwrap().to_owned();
    let output = install(&prefix, "");
    assert!(output.status.success() && output.stderr.is_empty(), "{output:?}");
    assert_eq!(shell(&prefix, "pkg-config --modversion slitpose-pose"), env!("CARGO_PKG_VERSION"));
    let (source, program) = (host("examples/c/follow_pose.c"), folder.path().join("follow_pose"));
    let (source, program) = (source.display(), program.display());
    shell(&prefix, &format!("cc -std=c11 $(pkg-config --cflags slitpose-pose) -o '{program}' '{source}'"));
    // Installed is what this tree has, and it is what was found: the source has no other header beside it.
    let installed = std::fs::read(format!("{prefix}/include/slitpose_pose.h")).unwrap();
    assert_eq!(installed, std::fs::read(host("include/slitpose_pose.h")).unwrap());
    assert_eq!(shell(&prefix, "pkg-config --cflags slitpose-pose"), format!("-I{prefix}/include"));
}

#[test]
fn a_package_is_staged_under_destdir_and_a_relative_prefix_is_refused() {
    let folder = TempDir::new().unwrap();
    let stage = folder.path().to_str().unwrap();
    assert!(install("/opt/slitpose", stage).status.success());
    let package = std::fs::read_to_string(format!("{stage}/opt/slitpose/share/pkgconfig/slitpose-pose.pc")).unwrap();
    assert!(package.starts_with("prefix=/opt/slitpose\n") && !package.contains(stage), "{package}");
    assert!(Path::new(&format!("{stage}/opt/slitpose/include/slitpose_pose.h")).exists());

    let refused = install("local", stage);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("PREFIX=local"), "{refused:?}");
    assert!(!Path::new(&format!("{stage}local")).exists());
}

/// `cc` and `c++` must be there; others are tried where they are.
#[test]
fn header_and_examples_compile_without_warnings_in_every_standard() {
    const WARNINGS: [&str; 7] = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wundef", "-Werror"];
    let folder = TempDir::new().unwrap();
    let alone = folder.path().join("alone.c");
    std::fs::write(&alone, "#define _POSIX_C_SOURCE 200809L\n#include \"slitpose_pose.h\"\n").unwrap();
    let sources = [alone, host("examples/c/follow_pose.c"), host("examples/c/virtual_wall.c")];
    let in_c: &[&[&str]] = &[&["-std=c99"], &["-std=c11"]];
    let in_cpp: &[&[&str]] = &[&["-x", "c++", "-std=c++11"], &["-x", "c++", "-std=c++17"]];
    for (compiler, standards) in
        [("cc", in_c), ("c++", in_cpp), ("gcc", in_c), ("clang", in_c), ("clang++", in_cpp), ("musl-gcc", in_c)]
    {
        if Command::new(compiler).arg("--version").output().is_err() {
            assert!(!["cc", "c++"].contains(&compiler), "there is no `{compiler}`; on Debian: apt-get install g++");
            println!("no {compiler}");
            continue;
        }
        for (standard, source) in standards.iter().flat_map(|s| sources.iter().map(move |source| (s, source))) {
            let mut command = Command::new(compiler);
            command.args(*standard).args(WARNINGS).arg("-O2").arg("-I").arg(host("include"));
            let output = command.args(["-c", "-o"]).arg(folder.path().join("object")).arg(source).output().unwrap();
            assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
        }
    }
}
