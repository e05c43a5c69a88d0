"""The carrier as a KiCad board: places the footprints, routes, fills the ground planes, writes `carrier.kicad_pcb`.

Needs KiCad's own Python (`import pcbnew`) and its footprint libraries. Four layers: parts and signals in front, ground plane
in the first inner layer, signals in the second and at the back, ground around them.
"""
from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pcbnew

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from design import boards  # noqa: E402
from design.__main__ import write  # noqa: E402
from design.circuit import NO_CONNECTION  # noqa: E402
from layout import placement, router  # noqa: E402

LIBRARIES = Path(os.environ.get("KICAD9_FOOTPRINT_DIR", "/usr/share/kicad/footprints"))
OUTPUT = Path(__file__).resolve().parents[1] / "kicad" / "carrier" / "carrier.kicad_pcb"
ORIGIN = (30.0, 30.0)  # of the board on its sheet
WIDE = {"+5V", "+5VA", "+5VE", "IN_5V", "+9V", "+12V", "AVDD", "+3V3", *(f"{n}_{i}" for n in ("DRAIN", "SENSE") for i in range(6))}
COPPER = (pcbnew.F_Cu, pcbnew.In2_Cu, pcbnew.B_Cu)


def mm(value: float) -> int:
    return pcbnew.FromMM(value)


def at(x: float, y: float) -> pcbnew.VECTOR2I:
    return pcbnew.VECTOR2I(mm(x + ORIGIN[0]), mm(y + ORIGIN[1]))


def empty_board() -> pcbnew.BOARD:
    board = pcbnew.CreateEmptyBoard()
    board.SetCopperLayerCount(4)
    board.SetLayerType(pcbnew.In1_Cu, pcbnew.LT_POWER)
    outline = pcbnew.PCB_SHAPE(board, pcbnew.SHAPE_T_RECT)
    outline.SetLayer(pcbnew.Edge_Cuts)
    outline.SetStart(at(0, 0))
    outline.SetEnd(at(placement.WIDTH, placement.HEIGHT))
    outline.SetWidth(mm(0.1))
    board.Add(outline)
    return board


def load(identifier: str) -> pcbnew.FOOTPRINT:
    library, name = identifier.split(":")
    footprint = pcbnew.FootprintLoad(str(LIBRARIES / f"{library}.pretty"), name)
    if footprint is None:
        raise SystemExit(f"no footprint {identifier}")
    footprint.SetFPID(pcbnew.LIB_ID(library, name))
    return footprint


def place(board: pcbnew.BOARD) -> None:
    circuit = boards.carrier()
    nets = {}
    for name in circuit.nets():
        nets[name] = pcbnew.NETINFO_ITEM(board, name)
        board.Add(nets[name])
    places = placement.carrier()
    missing = set(circuit.parts) ^ set(places)
    if missing:
        raise SystemExit(f"without a place, or unknown: {sorted(missing)}")
    for reference, part in circuit.parts.items():
        footprint = load(part.kind.footprint)
        footprint.SetReference(reference)
        footprint.SetValue(part.kind.value)
        x, y, turn = places[reference]
        footprint.SetPosition(at(x, y))
        footprint.SetOrientationDegrees(turn)
        text = footprint.Reference()
        text.SetLayer(pcbnew.F_Fab)
        for pad in footprint.Pads():
            net = part.nets.get(pad.GetNumber(), "GND" if pad.GetNumber() in ("MP", "S1") else NO_CONNECTION)
            if net != NO_CONNECTION:
                pad.SetNet(nets[net])
            if reference == "J3":
                # No room for the spokes of a thermal relief between its contacts.
                pad.SetLocalZoneConnection(pcbnew.ZONE_CONNECTION_FULL)
        board.Add(footprint)
    for i, (x, y) in enumerate(placement.HOLES):
        hole = load("MountingHole:MountingHole_3.2mm_M3")
        hole.SetReference(f"H{i + 1}")
        hole.Reference().SetLayer(pcbnew.F_Fab)
        hole.SetPosition(at(x, y))
        hole.SetBoardOnly(True)
        hole.SetExcludedFromBOM(True)
        board.Add(hole)


def rectangles(board: pcbnew.BOARD) -> list[router.Rectangle]:
    found = []
    for footprint in board.Footprints():
        for pad in footprint.Pads():
            box = pad.GetBoundingBox()
            through = pad.GetAttribute() in (pcbnew.PAD_ATTRIB_PTH, pcbnew.PAD_ATTRIB_NPTH)
            layers = tuple(range(3)) if through else tuple(i for i, layer in enumerate(COPPER) if pad.IsOnLayer(layer))
            if not layers:
                continue
            net = pad.GetNetCode() or -1
            grow = 0.1 if pad.GetAttribute() == pcbnew.PAD_ATTRIB_NPTH else 0.0
            found.append(router.Rectangle(
                net, layers, pcbnew.ToMM(box.GetLeft()) - ORIGIN[0] - grow, pcbnew.ToMM(box.GetTop()) - ORIGIN[1] - grow,
                pcbnew.ToMM(box.GetRight()) - ORIGIN[0] + grow, pcbnew.ToMM(box.GetBottom()) - ORIGIN[1] + grow,
                pad.GetShape() in (pcbnew.PAD_SHAPE_CIRCLE, pcbnew.PAD_SHAPE_OVAL),
            ))
    return found


def route(board: pcbnew.BOARD) -> list[str]:
    """Routes in a process of its own, with PyPy if it is there: ten times as fast, and without KiCad."""
    names = {item.GetNetCode(): str(name) for name, item in board.GetNetsByName().items()}
    ground = board.FindNet("GND").GetNetCode()
    task = {
        "width": placement.WIDTH, "height": placement.HEIGHT, "plane": ground,
        "wide": [code for code, name in names.items() if name in WIDE], "pads": [list(vars(item).values()) for item in rectangles(board)],
    }
    python = shutil.which("pypy3") or sys.executable
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder, "task.json"), Path(folder, "routes.json")
        given.write_text(json.dumps(task))
        subprocess.run([python, "-m", "layout.router", given, found], check=True, cwd=Path(__file__).resolve().parents[1])
        result = json.loads(found.read_text())
    for net, tracks, vias in result["routes"]:
        for layer, x0, y0, x1, y1, width in tracks:
            track = pcbnew.PCB_TRACK(board)
            track.SetStart(at(x0, y0))
            track.SetEnd(at(x1, y1))
            track.SetWidth(mm(width))
            track.SetLayer(COPPER[layer])
            track.SetNetCode(net)
            board.Add(track)
        for x, y in vias:
            via = pcbnew.PCB_VIA(board)
            via.SetPosition(at(x, y))
            via.SetFrontWidth(mm(router.VIA))
            via.SetDrill(mm(router.DRILL))
            via.SetNetCode(net)
            board.Add(via)
    return [names[net] for net in result["open"]]


def pour(board: pcbnew.BOARD) -> None:
    for layer in (pcbnew.F_Cu, pcbnew.In1_Cu, pcbnew.In2_Cu, pcbnew.B_Cu):
        zone = pcbnew.ZONE(board)
        zone.SetLayer(layer)
        zone.SetNetCode(board.FindNet("GND").GetNetCode())
        corners = ((0.5, 0.5), (placement.WIDTH - 0.5, 0.5), (placement.WIDTH - 0.5, placement.HEIGHT - 0.5), (0.5, placement.HEIGHT - 0.5))
        zone.AddPolygon(pcbnew.VECTOR_VECTOR2I([at(*corner) for corner in corners]))
        zone.SetLocalClearance(mm(0.2))
        zone.SetMinThickness(mm(0.2))
        zone.SetThermalReliefGap(mm(0.2))
        zone.SetThermalReliefSpokeWidth(mm(0.25))
        zone.SetIslandRemovalMode(pcbnew.ISLAND_REMOVAL_MODE_ALWAYS)
        board.Add(zone)


if __name__ == "__main__":
    started = time.time()
    layout = empty_board()
    place(layout)
    left = [] if "--place" in sys.argv else route(layout)
    pour(layout)
    pcbnew.SaveBoard(str(OUTPUT), layout)
    # Only a board read from a file can be filled; the rules are those of the project's file, which `run write` makes.
    layout = pcbnew.LoadBoard(str(OUTPUT))
    pcbnew.ZONE_FILLER(layout).Fill(layout.Zones())
    pcbnew.SaveBoard(str(OUTPUT), layout)
    write(Path(__file__).resolve().parents[1])
    print(f"{OUTPUT.name}: {len(left)} nets open {left}, {time.time() - started:.0f} s")
    sys.exit(bool(left))
