//! `slitpose scene export`: what a workshop needs to make a head, by the package for Python, which has the CAD kernel.

use std::ffi::OsStr;
use std::io::Write;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use super::super::options::{self, open_scene};
use super::super::{CommandError, Outcome};

/// Makes files for a workshop: housing, masks, drawings, bill of materials and assembly page.
///
/// STEP and STL of each part, one STEP of all parts in place, DXF of each mask, drawings as SVG, `bill.csv`, and
/// `index.html` with pictures, steps and checks: walls, light paths, and the tool's clearance over the workspace. Places
/// of slits, detectors and emitters are those of the scene. Heads of detectors around the tool behind slits on the base.
/// Needs the package for Python with its extra `cad`. Designed only: no head has been built.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose scene export orderable --output head\n  \
                        slitpose scene export mine.toml --jig --python ~/cad/bin/python --output head")]
pub(super) struct Args {
    /// Scene file, or the name of a shipped scene
    #[arg(value_parser = options::scenes(), hide_possible_values = true)]
    scene: String,
    /// Folder for the files; made if absent
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// Also a nest, a stage and a cone, for calibration without an instrument
    #[arg(long)]
    jig: bool,
    /// TOML with other sizes of parts, such as: detector.length = 16.2
    #[arg(long, value_name = "FILE")]
    sizes: Option<PathBuf>,
    /// Poses at which tool and housing are checked for contact
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..))]
    poses: u32,
    /// The interpreter that has the package
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
}

const MODULE: &str = "slitpose.export";

/// Keeps a folder named `slitpose` in the working folder from standing for the package.
const SAFE_PATH: (&str, &str) = ("PYTHONSAFEPATH", "1");

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let file = open_scene(&args.scene)?;
    require_package(args)?;
    let mut command = Command::new(&args.python);
    command
        .env(SAFE_PATH.0, SAFE_PATH.1)
        .args(["-m", MODULE, "-", "--output"])
        .arg(&args.output)
        .args(["--poses", &args.poses.to_string()]);
    if args.jig {
        command.arg("--jig");
    }
    if let Some(sizes) = &args.sizes {
        command.args([OsStr::new("--sizes"), sizes.as_os_str()]);
    }
    let mut child = command.stdin(Stdio::piped()).spawn().with_context(|| format!("{}", args.python.display()))?;
    if let Some(mut scene) = child.stdin.take() {
        // A child that ends early states its own reason.
        let _ = scene.write_all(file.source.as_bytes());
    }
    let status = child.wait().context(MODULE)?;
    Ok(if status.success() { Outcome::Done } else { Outcome::Failed })
}

/// An interpreter without the package would say so in its own words, without the next step.
fn require_package(args: &Args) -> Result<(), CommandError> {
    let python = args.python.display();
    let found = Command::new(&args.python)
        .env(SAFE_PATH.0, SAFE_PATH.1)
        .args(["-c", "import slitpose.export"])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    match found {
        Ok(status) if status.success() => Ok(()),
        Ok(_) => bail!(
            "{python} has no package with {MODULE}; make it with `host/python/run --wheel`, install it with \
             `pip install 'slitpose[cad] @ file:///…/slitpose-….whl'`, or name another interpreter with --python"
        ),
        Err(error) => bail!("{python}: {error}; install Python 3.11 or newer, or name the interpreter with --python"),
    }
}
