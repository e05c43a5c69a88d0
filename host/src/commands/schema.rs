//! `slitpose schema`: what may stand in a file or a stream, as JSON Schema.

use schemars::{JsonSchema, Schema, SchemaGenerator, generate::SchemaSettings, json_schema};
use serde_json::{Map, Value, json};

use super::{CommandError, Outcome, config, options};
use crate::sink::{EdgeLine, FaultLine, FrameLine};
use slitpose_calibration::file_schema;
use slitpose_head::scene_file::{Key, Kind, OWN, PER_CELL, SECTIONS};
use slitpose_tracking::columns::{COLUMNS, Column, Get, entries};
use slitpose_tracking::telemetry::report_schema;

/// Prints the JSON Schema of a file or a stream: editors complete and check by it, other programs make types of it.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  slitpose schema scene > scene.schema.json\n  slitpose schema ndjson\n\n\
                        With `#:schema scene.schema.json` as its first line, a scene file is completed, explained and \
                        checked by editors that know TOML (Even Better TOML for VS Code, Taplo).")]
pub(super) struct Args {
    /// What it describes
    #[arg(value_enum)]
    of: Of,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Of {
    /// A scene file
    Scene,
    /// What `calibrate` writes
    Calibration,
    /// The configuration file of `run`
    Config,
    /// A line of `--format ndjson`
    Ndjson,
    /// What /status answers
    Status,
}

pub(super) fn run(args: &Args) -> Result<Outcome, CommandError> {
    let schema = match args.of {
        Of::Scene => scene(),
        Of::Calibration => file_schema(),
        Of::Config => config::schema(),
        Of::Ndjson => ndjson(),
        Of::Status => report_schema(),
    };
    options::print(&format!("{:#}\n", schema.as_value()))
}

fn of_key(key: &Key) -> (String, Value) {
    let numbers = |least: usize, most: usize| json!({ "type": "array", "items": { "type": "number" }, "minItems": least, "maxItems": most });
    let mut value = match key.kind {
        Kind::Text => json!({ "type": "string" }),
        Kind::OneOf(words) => json!({ "enum": words }),
        Kind::Number => json!({ "type": "number" }),
        Kind::Whole(least, most) => json!({ "type": "integer", "minimum": least, "maximum": most }),
        Kind::Vector(count, _) => numbers(count, count),
        Kind::List(most) => numbers(0, most),
        Kind::Matrix(rows, columns, _) => {
            json!({ "type": "array", "items": numbers(columns, columns), "minItems": rows, "maxItems": rows })
        }
        Kind::Pairs(most) => json!({ "type": "array", "items": numbers(2, 2), "minItems": 1, "maxItems": most }),
        Kind::Slots => {
            json!({ "type": "array", "items": { "type": "array", "items": { "type": "integer", "minimum": 0 } } })
        }
    };
    value["description"] = key.meaning.into();
    (key.name.to_owned(), value)
}

fn scene() -> Schema {
    let properties = |keys: &[Key]| keys.iter().map(of_key).collect::<Map<_, _>>();
    let section = |name: &str| json!({ "$ref": format!("#/$defs/{name}") });
    let mut cell = properties(&OWN);
    cell.extend(SECTIONS[..PER_CELL].iter().map(|of| (of.name.to_owned(), section(of.name))));
    let cells = json!({ "type": "object", "properties": cell, "additionalProperties": false });
    let mut top = Map::new();
    top.insert(
        "name".to_owned(),
        json!({ "type": "string", "description": "name of the scene; default: that of the file" }),
    );
    top.extend(SECTIONS.iter().map(|of| (of.name.to_owned(), section(of.name))));
    top.insert(
        "cell".to_owned(),
        json!({ "type": "array", "items": cells, "minItems": 1,
                "description": "cells; their keys in sections replace those of the file" }),
    );
    let sections = SECTIONS.iter().map(|of| {
        let (properties, meaning) = (properties(of.keys), of.meaning);
        let object = json!({
            "type": "object", "description": meaning, "properties": properties, "additionalProperties": false
        });
        (of.name.to_owned(), object)
    });
    json_schema!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Scene of slitpose",
        "type": "object",
        "properties": top,
        "required": ["cell"],
        "additionalProperties": false,
        "$defs": sections.collect::<Map<_, _>>(),
    })
}

/// Of one line: a pose, or another kind of object.
fn ndjson() -> Schema {
    fn of<T: JsonSchema>(generator: &mut SchemaGenerator, kind: &str) -> Value {
        let mut schema = generator.clone().into_root_schema_for::<T>();
        schema.remove("$schema");
        schema.insert("title".to_owned(), kind.into());
        let mut schema = schema.to_value();
        schema["properties"]["kind"] = json!({ "const": kind });
        schema
    }
    let mut generator = SchemaSettings::draft2020_12()
        .with(|settings| settings.inline_subschemas = true)
        .for_serialize()
        .into_generator();
    let columns: Vec<&'static Column> = COLUMNS.iter().filter(|column| !column.key.is_empty()).collect();
    let mut pose = object(&columns, 0);
    pose["title"] = "pose".into();
    // Objects of other kinds have this key, and poses have not.
    pose["not"] = json!({ "required": ["kind"] });
    json_schema!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Line of NDJSON of slitpose",
        "anyOf": [
            pose,
            of::<FrameLine<'_>>(&mut generator, "frame"),
            of::<EdgeLine>(&mut generator, "edge"),
            of::<FaultLine<'_>>(&mut generator, "injected_fault"),
        ],
    })
}

/// The object whose keys go on behind `behind` bytes.
fn object(columns: &[&'static Column], behind: usize) -> Value {
    let property = |(name, first, inner): (&str, &Column, Option<(&[&'static Column], usize)>)| {
        let value = inner.map_or_else(|| of_column(first), |(columns, behind)| object(columns, behind));
        let value = if first.is_null { json!({ "anyOf": [value, { "type": "null" }] }) } else { value };
        (name.to_owned(), value)
    };
    json!({ "type": "object", "properties": entries(columns, behind).map(property).collect::<Map<_, _>>() })
}

fn of_column(column: &Column) -> Value {
    let numbers =
        |count: usize| json!({ "type": "array", "items": { "type": "number" }, "minItems": count, "maxItems": count });
    let mut value = match column.get {
        Get::Integer(_) | Get::Count(_) => json!({ "type": "integer", "minimum": 0 }),
        Get::Number(_) => json!({ "type": "number" }),
        Get::Flag(_) => json!({ "type": "boolean" }),
        Get::Word(words, _) => match words().into_iter().filter(|word| !word.is_empty()).collect::<Vec<_>>() {
            words if words.is_empty() => json!({ "type": "string" }),
            words => json!({ "enum": words }),
        },
        Get::Device(_) | Get::Directions(_) => json!({ "type": "string" }),
        Get::Cells(_) => json!({ "type": "array", "items": { "type": "integer", "minimum": 0 } }),
        Get::Translation(_) | Get::Velocity(_) | Get::AngularVelocity(_) => numbers(3),
        Get::Rotation(_) => numbers(4),
        Get::Covariance(_) | Get::Correlation(_) => numbers(36),
        Get::TwistSigma(_) => numbers(6),
    };
    let unit = if column.unit.is_empty() { String::new() } else { format!(", {}", column.unit) };
    value["description"] = format!("{}{unit}", column.meaning).into();
    value
}
