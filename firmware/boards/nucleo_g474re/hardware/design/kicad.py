"""KiCad files (format 20231120, KiCad 8 and later): schematic, symbol library, netlist, project.

The files are complete without any library of KiCad. Identifiers are derived from names, so that the same design gives
the same files.
"""
from __future__ import annotations

import json
import uuid
from pathlib import Path

from .circuit import Circuit
from .drawing import Placed, Sheet
from .symbols import LIBRARY, POWER, Symbol

MM = 1.27
VERSION = 20231120
NAMESPACE = uuid.UUID("5d5a4c1e-2b8f-4c57-9d53-6f1b8d1a7c10")
COMMENT = "Designed and simulated, never built"


def identifier(*names: object) -> str:
    return str(uuid.uuid5(NAMESPACE, "/".join(map(str, names))))


def quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def mm(value: float) -> str:
    return f"{value * MM:.4f}".rstrip("0").rstrip(".")


def _font(size: float = 1.27, justify: str = "", hidden: bool = False) -> str:
    side = f" (justify {justify})" if justify and justify != "center" else ""
    return f"(effects (font (size {size} {size})){side}{' (hide yes)' if hidden else ''})"


def _symbol(symbol: Symbol, prefix: str) -> str:
    def at(point):
        return f"{mm(point[0])} {mm(point[1])}"

    stroke = "(stroke (width 0.2) (type default))"
    lines = [f"(symbol {quoted(prefix + symbol.name)}"]
    if symbol.power:
        lines.append("(power)")
    if not symbol.show_numbers:
        lines.append("(pin_numbers hide)")
    lines.append(f"(pin_names (offset 0.5){'' if symbol.show_names else ' hide'}) (exclude_from_sim no) (in_bom yes) (on_board yes)")
    for key, place in (("Reference", symbol.reference), ("Value", symbol.value)):
        text = ("#PWR" if symbol.power else "U") if key == "Reference" else symbol.name
        lines.append(f"(property {quoted(key)} {quoted(text)} (at {at(place)} 0) {_font(justify=place[2], hidden=symbol.power and key == 'Reference')})")
    lines.append(f'(property "Footprint" "" (at 0 0 0) {_font(hidden=True)}) (property "Datasheet" "" (at 0 0 0) {_font(hidden=True)})')
    for unit, shapes in symbol.shapes.items():
        lines.append(f"(symbol {quoted(f'{symbol.name}_{unit}_1')}")
        for shape in shapes:
            match shape:
                case ("line", points):
                    lines.append(f"(polyline (pts {' '.join(f'(xy {at(p)})' for p in points)}) {stroke} (fill (type none)))")
                case ("rectangle", a, b):
                    lines.append(f"(rectangle (start {at(a)}) (end {at(b)}) {stroke} (fill (type none)))")
                case ("circle", centre, radius):
                    lines.append(f"(circle (center {at(centre)}) (radius {mm(radius)}) {stroke} (fill (type none)))")
        for pin in symbol.pins:
            if pin.unit == unit:
                angle = {(1, 0): 180, (-1, 0): 0, (0, 1): 270, (0, -1): 90}[pin.out]
                lines.append(
                    f"(pin {pin.electrical} line (at {at(pin.at)} {angle}) (length {mm(pin.length)}){' hide' if pin.hidden else ''} "
                    f"(name {quoted(pin.name)} {_font(1.0)}) (number {quoted(pin.number)} {_font(1.0)}))"
                )
        lines.append(")")
    lines.append(")")
    return "\n".join(lines)


def symbol_library() -> str:
    symbols = "\n".join(_symbol(symbol, "") for symbol in LIBRARY.values())
    return f'(kicad_symbol_lib (version {VERSION}) (generator "slitpose")\n{symbols}\n)\n'


def _placed(placed: Placed, circuit: Circuit, project: str, path: str) -> str:
    part, symbol = circuit.parts[placed.reference], placed.symbol
    kind = part.kind
    x, y = placed.at

    def field(key: str, text: str, place=None, hidden: bool = False) -> str:
        if place is None:
            return f"(property {quoted(key)} {quoted(text)} (at {mm(x)} {mm(y)} 0) {_font(hidden=True)})"
        dx, dy, justify = place
        angle = 0
        if symbol.name == "OPA2" and placed.unit == 3:
            dx, dy = 3, (1 if key == "Reference" else -1)
        if placed.mirrored:
            dx = -1.5
        if placed.rotation in (90, 270):
            # Lying: reference above, value below, level text.
            dx, dy, justify = 0, (2.6 if key == "Reference" else -2.6), "center"
            angle = 90
        return (
            f"(property {quoted(key)} {quoted(text)} (at {mm(x + dx)} {mm(y - dy)} {angle}) {_font(1.27, justify, hidden)})"
        )

    fields = [field("Reference", placed.reference, symbol.reference), field("Value", kind.value, symbol.value)]
    fields += [
        field("Footprint", kind.footprint), field("Datasheet", kind.source), field("Manufacturer", kind.manufacturer),
        field("MPN", kind.number),
    ]
    pins = " ".join(
        f"(pin {quoted(pin.number)} (uuid {quoted(identifier(project, placed.reference, pin.number))}))" for pin in kind.pins
    )
    mirror = " (mirror y)" if placed.mirrored else ""
    return (
        f'(symbol (lib_id {quoted("slitpose:" + symbol.name)}) (at {mm(x)} {mm(y)} {placed.rotation}){mirror} (unit {placed.unit}) '
        f"(exclude_from_sim no) (in_bom {'yes' if kind.on_bill else 'no'}) (on_board yes) (dnp no) "
        f"(uuid {quoted(identifier(project, placed.reference, 'unit', placed.unit))})\n{' '.join(fields)}\n{pins}\n"
        f"(instances (project {quoted(project)} (path {quoted(path)} (reference {quoted(placed.reference)}) (unit {placed.unit})))))"
    )


def _power(net: str, at, direction, sheet: Sheet, project: str, path: str, number: int, flag: bool = False) -> str:
    name = "PWR_FLAG" if flag else net
    symbol = LIBRARY[name]
    x, y = at
    reference = f"#{'FLG' if flag else 'PWR'}{number:03d}"
    dx, dy, _ = symbol.value
    # Quarter turns from the symbol's own direction, ground down and rails up; lying ones have their name beside them.
    rotation = {(0, 1): 0, (1, 0): 90, (0, -1): 180, (-1, 0): 270}[direction]
    rotation = rotation if name == "GND" else 0 if flag else (rotation + 180) % 360
    angle = 0
    if direction[0]:
        dx, dy, angle = direction[0] * (2.6 + 0.45 * len(name)), 0, 90
    elif rotation == 180:
        dy = -dy
    key = identifier(project, sheet.name, reference)
    return (
        f'(symbol (lib_id {quoted("slitpose:" + name)}) (at {mm(x)} {mm(y)} {rotation}) (unit 1) (exclude_from_sim no) (in_bom no) '
        f'(on_board yes) (dnp no) (uuid "{key}")\n'
        f'(property "Reference" "{reference}" (at {mm(x)} {mm(y)} 0) {_font(hidden=True)}) '
        f'(property "Value" {quoted(name)} (at {mm(x + dx)} {mm(y - dy)} {angle}) {_font(1.0)}) '
        f'(property "Footprint" "" (at {mm(x)} {mm(y)} 0) {_font(hidden=True)}) '
        f'(property "Datasheet" "" (at {mm(x)} {mm(y)} 0) {_font(hidden=True)})\n'
        f'(pin "1" (uuid "{identifier(key, 1)}"))\n'
        f'(instances (project {quoted(project)} (path {quoted(path)} (reference "{reference}") (unit 1)))))'
    )


def schematic(sheet: Sheet, project: str, path: str, page: int, shared: set[str], counter: list[int]) -> str:
    """The file of one sheet; `shared` are the nets that other sheets have, too."""
    own = identifier(project, sheet.name)
    names = sorted({placed.symbol.name for placed in sheet.placed} | {net for net, _, _ in sheet.powers} | ({"PWR_FLAG"} if sheet.flags else set()))
    out = [
        f'(kicad_sch (version {VERSION}) (generator "slitpose") (generator_version "1") (uuid "{own}") (paper "{sheet.paper}")',
        f'(title_block (title {quoted(sheet.title)}) (rev "1") (company "slitpose") (comment 1 {quoted(COMMENT)}))',
        "(lib_symbols", *(_symbol(LIBRARY[name], "slitpose:") for name in names), ")",
    ]
    for x, y in sorted(sheet.junctions()):
        out.append(f'(junction (at {mm(x)} {mm(y)}) (diameter 0) (color 0 0 0 0) (uuid "{identifier(own, "junction", x, y)}"))')
    for x, y in sheet.open_pins:
        out.append(f'(no_connect (at {mm(x)} {mm(y)}) (uuid "{identifier(own, "open", x, y)}"))')
    for i, (a, b) in enumerate(sheet.wires):
        out.append(
            f"(wire (pts (xy {mm(a[0])} {mm(a[1])}) (xy {mm(b[0])} {mm(b[1])})) (stroke (width 0) (type default)) "
            f'(uuid "{identifier(own, "wire", i)}"))'
        )
    for i, (a, b) in enumerate(sheet.frames):
        out.append(
            f"(rectangle (start {mm(a[0])} {mm(a[1])}) (end {mm(b[0])} {mm(b[1])}) (stroke (width 0.15) (type dash)) "
            f'(fill (type none)) (uuid "{identifier(own, "frame", i)}"))'
        )
    for i, (text, (x, y), size) in enumerate(sheet.texts):
        out.append(f'(text {quoted(text)} (exclude_from_sim no) (at {mm(x)} {mm(y)} 0) {_font(size, "left")} (uuid "{identifier(own, "text", i)}"))')
    for i, (net, (x, y), direction) in enumerate(sheet.labels):
        angle = {(1, 0): 0, (0, -1): 90, (-1, 0): 180, (0, 1): 270}[direction]
        justify = "left" if angle in (0, 90) else "right"
        key = identifier(own, "label", i)
        if net in shared:
            out.append(f'(global_label {quoted(net)} (shape passive) (at {mm(x)} {mm(y)} {angle}) {_font(1.27, justify)} (uuid "{key}"))')
        else:
            out.append(f'(label {quoted(net)} (at {mm(x)} {mm(y)} {angle}) {_font(1.27, justify + " bottom")} (uuid "{key}"))')
    for net, at, direction in sheet.powers:
        counter[0] += 1
        out.append(_power(net, at, direction, sheet, project, path, counter[0]))
    for at in sheet.flags:
        counter[0] += 1
        out.append(_power("", at, (0, 1), sheet, project, path, counter[0], flag=True))
    out += [_placed(placed, sheet.circuit, project, path) for placed in sheet.placed]
    if page == 1:
        out.append('(sheet_instances (path "/" (page "1")))')
    return "\n".join([*out, ")"]) + "\n"


def root(project: str, title: str, sheets: list[Sheet], notes: list[str]) -> str:
    own = identifier(project, "root")
    out = [
        f'(kicad_sch (version {VERSION}) (generator "slitpose") (generator_version "1") (uuid "{own}") (paper "A4")',
        f'(title_block (title {quoted(title)}) (rev "1") (company "slitpose") (comment 1 {quoted(COMMENT)}))', "(lib_symbols)",
    ]
    for i, note in enumerate(notes):
        out.append(f'(text {quoted(note)} (exclude_from_sim no) (at {mm(16)} {mm(16 + 4 * i)} 0) {_font(1.8, "left")} (uuid "{identifier(own, i)}"))')
    for i, sheet in enumerate(sheets):
        x, y = 16 + 52 * i, 60
        out.append(
            f"(sheet (at {mm(x)} {mm(y)}) (size {mm(44)} {mm(22)}) (stroke (width 0.2) (type solid)) (fill (color 0 0 0 0.0))\n"
            f'(uuid "{identifier(own, sheet.name)}")\n'
            f'(property "Sheetname" {quoted(sheet.name)} (at {mm(x)} {mm(y - 1)} 0) {_font(1.5, "left bottom")})\n'
            f'(property "Sheetfile" {quoted(f"{project}_{sheet.name}.kicad_sch")} (at {mm(x)} {mm(y + 23)} 0) {_font(1.27, "left top")})\n'
            f'(instances (project {quoted(project)} (path "/{own}" (page "{i + 2}")))))'
        )
    out.append('(sheet_instances (path "/" (page "1")))')
    return "\n".join([*out, ")"]) + "\n"


def netlist(circuit: Circuit) -> str:
    """KiCad's netlist, written from the circuit; what kicad-cli exports from the drawing must join the same pins."""
    out = ['(export (version "E")', f'(design (source "{circuit.name}") (tool "slitpose"))', "(components"]
    for part in circuit.parts.values():
        kind = part.kind
        out.append(
            f"(comp (ref {quoted(part.reference)}) (value {quoted(kind.value)}) (footprint {quoted(kind.footprint)}) "
            f"(fields (field (name \"Manufacturer\") {quoted(kind.manufacturer)}) (field (name \"MPN\") {quoted(kind.number)})))"
        )
    out += [")", "(nets"]
    for code, (net, pins) in enumerate(sorted(circuit.nets().items()), 1):
        nodes = " ".join(f"(node (ref {quoted(reference)}) (pin {quoted(number)}))" for reference, number in pins)
        out.append(f'(net (code "{code}") (name {quoted(net)}) {nodes})')
    return "\n".join([*out, "))"]) + "\n"


# What the layout keeps, and the rule check tests: millimetres (layout.router has the first four).
RULES = {
    "min_clearance": 0.145, "min_track_width": 0.2, "min_via_diameter": 0.5, "min_through_hole_diameter": 0.25,
    "min_via_annular_width": 0.12, "min_copper_edge_clearance": 0.3, "min_hole_to_hole": 0.25, "min_hole_clearance": 0.15,
    # Each ground pad has a via of its own beside its spokes.
    "min_resolved_spokes": 1,
}


def project_file(project: str) -> dict:
    # The widths of wires and buses are those of the drawing, in mils: without them wires are invisible.
    net_class = {
        "name": "Default", "clearance": 0.145, "track_width": 0.2, "via_diameter": 0.5, "via_drill": 0.25, "wire_width": 6,
        "bus_width": 12, "line_style": 0, "diff_pair_gap": 0.25, "diff_pair_via_gap": 0.25, "diff_pair_width": 0.2,
        "microvia_diameter": 0.3, "microvia_drill": 0.1, "pcb_color": "rgba(0, 0, 0, 0.000)",
        "schematic_color": "rgba(0, 0, 0, 0.000)", "priority": 2147483647,
    }
    return {
        "board": {"design_settings": {"rules": RULES}}, "meta": {"filename": f"{project}.kicad_pro", "version": 1},
        "net_settings": {"classes": [net_class], "meta": {"version": 3}},
    }


def write(folder: Path, circuit: Circuit, sheets: list[Sheet], title: str, notes: list[str] = ()) -> list[Path]:
    """All files of one board. A board of one sheet has it as its root."""
    project, counter, files = circuit.name, [0], {}
    if len(sheets) == 1:
        sheet = sheets[0]
        sheet.name = "root"
        files[f"{project}.kicad_sch"] = schematic(sheet, project, f"/{identifier(project, 'root')}", 1, set(), counter)
    else:
        on_sheets: dict[str, set[str]] = {}
        for sheet in sheets:
            for placed in sheet.placed:
                for net in circuit.parts[placed.reference].nets.values():
                    on_sheets.setdefault(net, set()).add(sheet.name)
        shared = {net for net, where in on_sheets.items() if len(where) > 1} - set(POWER)
        own = identifier(project, "root")
        files[f"{project}.kicad_sch"] = root(project, title, sheets, list(notes))
        for page, sheet in enumerate(sheets, 2):
            path = f"/{own}/{identifier(own, sheet.name)}"
            files[f"{project}_{sheet.name}.kicad_sch"] = schematic(sheet, project, path, page, shared, counter)
    files[f"{project}.net"] = netlist(circuit)
    files[f"{project}.kicad_pro"] = json.dumps(project_file(project), indent=2) + "\n"
    files["slitpose.kicad_sym"] = symbol_library()
    files["sym-lib-table"] = '(sym_lib_table (version 7)\n(lib (name "slitpose") (type "KiCad") (uri "${KIPRJMOD}/slitpose.kicad_sym") (options "") (descr ""))\n)\n'
    libraries = sorted({part.kind.footprint.split(":")[0] for part in circuit.parts.values()})
    rows = "\n".join(
        f'(lib (name "{name}") (type "KiCad") (uri "{"${KIPRJMOD}/slitpose.pretty" if name == "slitpose" else "${KICAD9_FOOTPRINT_DIR}/" + name + ".pretty"}") '
        '(options "") (descr ""))' for name in libraries
    )
    files["fp-lib-table"] = f"(fp_lib_table (version 7)\n{rows}\n)\n"
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in files.items():
        path = folder / name
        path.write_text(text)
        written.append(path)
    return written
