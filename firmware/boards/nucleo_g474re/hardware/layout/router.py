"""A maze router on a grid: A* over three layers, with rip-up of nets that stand in the way.

Copper of one net keeps other nets' centre lines away: by `NEAR` for narrow tracks, by `FAR` for vias and wide tracks.
`hard` marks what cannot move (pads, holes, edge), `soft` what the router itself has laid.
"""
from __future__ import annotations

import heapq
import json
import sys
from collections import defaultdict
from dataclasses import dataclass, field
from math import ceil, floor, hypot, sqrt
from pathlib import Path

GRID = 0.2
CLEARANCE = 0.15
TRACK, WIDE, VIA, DRILL = 0.2, 0.4, 0.5, 0.25
NEAR, FAR = CLEARANCE + TRACK / 2 + 0.01, CLEARANCE + VIA / 2 + 0.01
LAYERS = 3  # front, inner 2, back
VIA_COST, RIP_COST = 9.0, 20.0

Node = tuple[int, int, int]  # layer, column, row
STEPS = tuple((dx, dy, 1.414 if dx and dy else 1.0) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if dx or dy)


@dataclass(frozen=True)
class Rectangle:
    """Copper of a pad, on `layers`."""

    net: int
    layers: tuple[int, ...]
    left: float
    top: float
    right: float
    bottom: float
    round: bool = False


@dataclass
class Route:
    net: int
    tracks: list[tuple[int, float, float, float, float, float]] = field(default_factory=list)  # layer, x0, y0, x1, y1, width
    vias: list[tuple[float, float]] = field(default_factory=list)


class Router:
    def __init__(self, width: float, height: float, wide: set[int], margin: float = 0.5):
        self.columns, self.rows = int(width / GRID) + 1, int(height / GRID) + 1
        self.size = self.columns * self.rows
        self.wide = wide
        # Per layer and reach: owner of each node. 0 free, -1 several.
        self.hard = [[[0] * self.size for _ in range(2)] for _ in range(LAYERS)]
        self.soft: list[list[dict[int, dict[int, int]]]] = [[defaultdict(dict) for _ in range(2)] for _ in range(LAYERS)]
        self.no_via: set[int] = set()  # in and at pads to be soldered: a hole there would drain the solder
        self.routes: dict[int, list[Route]] = defaultdict(list)
        edge = margin + WIDE / 2
        for layer in range(LAYERS):
            for reach in range(2):
                self._rectangle(self.hard[layer][reach], -1, -9, -9, edge, height + 9)
                self._rectangle(self.hard[layer][reach], -1, width - edge, -9, width + 9, height + 9)
                self._rectangle(self.hard[layer][reach], -1, -9, -9, width + 9, edge)
                self._rectangle(self.hard[layer][reach], -1, -9, height - edge, width + 9, height + 9)

    def _span(self, low: float, high: float, count: int) -> range:
        return range(max(0, ceil(low / GRID - 1e-9)), min(count - 1, floor(high / GRID + 1e-9)) + 1)

    def _rectangle(self, owners: list[int], net: int, left: float, top: float, right: float, bottom: float) -> None:
        for row in self._span(top, bottom, self.rows):
            for column in self._span(left, right, self.columns):
                i = row * self.columns + column
                owners[i] = net if owners[i] in (0, net) else -1

    def pad(self, pad: Rectangle) -> None:
        for layer in pad.layers:
            for reach, distance in enumerate((NEAR, FAR)):
                self._rounded(layer, reach, pad, distance)
        around = VIA / 2 + 0.05
        for row in self._span(pad.top - around, pad.bottom + around, self.rows):
            self.no_via.update(row * self.columns + c for c in self._span(pad.left - around, pad.right + around, self.columns))

    def _rounded(self, layer: int, reach: int, pad: Rectangle, distance: float) -> None:
        owners = self.hard[layer][reach]
        for row in self._span(pad.top - distance, pad.bottom + distance, self.rows):
            y = row * GRID
            dy = max(pad.top - y, 0, y - pad.bottom)
            for column in self._span(pad.left - distance, pad.right + distance, self.columns):
                x = column * GRID
                dx = max(pad.left - x, 0, x - pad.right)
                if dx * dx + dy * dy < distance * distance:
                    i = row * self.columns + column
                    owners[i] = pad.net if owners[i] in (0, pad.net) else -1

    def nodes_of(self, pad: Rectangle) -> list[Node]:
        """Grid points inside the pad, or the nearest to its middle."""
        # In a round pad, the square inside.
        inset = 0.02 + (0.147 * min(pad.right - pad.left, pad.bottom - pad.top) if pad.round else 0.0)
        found = [
            (layer, column, row)
            for layer in pad.layers
            for row in self._span(pad.top + inset, pad.bottom - inset, self.rows)
            for column in self._span(pad.left + inset, pad.right - inset, self.columns)
        ]
        middle = (round((pad.left + pad.right) / 2 / GRID), round((pad.top + pad.bottom) / 2 / GRID))
        return found or [(layer, *middle) for layer in pad.layers]

    def _blockers(self, net: int, layer: int, i: int, reach: int) -> set[int] | None:
        """Nets whose routes stand at a node; `None` if it is closed for good."""
        owner = self.hard[layer][reach][i]
        if owner not in (0, net):
            return None
        others = self.soft[layer][reach].get(i)
        return {other for other in others if other != net} if others else set()

    def search(self, net: int, sources: list[Node], goals: set[Node], rip: bool, plane: bool = False, banned: frozenset = frozenset()):
        """Cheapest path from a source to a goal; with `plane`, to any node where a via fits freely. With `rip`, through
        routes of other nets that are not `banned`. The nodes of the path, or `None`."""
        reach = 1 if net in self.wide else 0
        size, columns_, rows_ = self.size, self.columns, self.rows
        soft_near = [self.soft[layer][0] for layer in range(LAYERS)]
        soft_reach = [self.soft[layer][reach] for layer in range(LAYERS)]
        soft_far = [self.soft[layer][1] for layer in range(LAYERS)]
        hard_near = [self.hard[layer][0] for layer in range(LAYERS)]
        hard_reach = [self.hard[layer][reach] for layer in range(LAYERS)]
        hard_far = [self.hard[layer][1] for layer in range(LAYERS)]

        def code(node: Node) -> int:
            return node[0] * size + node[2] * columns_ + node[1]

        ends, starts = {code(goal) for goal in goals}, {code(source) for source in sources}
        if goals:
            low_c, high_c = min(g[1] for g in goals), max(g[1] for g in goals)
            low_r, high_r = min(g[2] for g in goals), max(g[2] for g in goals)

        def ahead(c: int, r: int) -> float:
            if not ends:
                return 0.0
            dx = low_c - c if c < low_c else c - high_c if c > high_c else 0
            dy = low_r - r if r < low_r else r - high_r if r > high_r else 0
            return dx + 0.414 * dy if dx > dy else dy + 0.414 * dx

        def foreign(owners: dict[int, int] | None) -> int:
            """Number of other nets' routes at a node; -1 if one of them must stay."""
            if not owners:
                return 0
            count = len(owners) - (net in owners)
            if count and (not rip or (banned and not banned.isdisjoint(other for other in owners if other != net))):
                return -1
            return count

        best = {start: 0.0 for start in starts}
        came: dict[int, int] = {}
        heap = []
        for start in starts:
            r, c = divmod(start % size, columns_)
            heap.append((ahead(c, r), start))
        heapq.heapify(heap)
        closed: set[int] = set()
        vias: dict[int, int] = {}

        def via(i: int) -> int:
            if i not in vias:
                total = -1 if i in self.no_via else 0
                for layer in range(LAYERS) if total == 0 else ():
                    owner = hard_far[layer][i]
                    count = -1 if owner != 0 and owner != net else foreign(soft_far[layer].get(i))
                    if count < 0:
                        total = -1
                        break
                    total += count
                vias[i] = total
            return vias[i]

        while heap:
            _, at = heapq.heappop(heap)
            if at in closed:
                continue
            closed.add(at)
            layer, i = divmod(at, size)
            if at in ends or (plane and via(i) == 0):
                path = [at]
                while path[-1] in came:
                    path.append(came[path[-1]])
                return [(node // size, node % size % columns_, node % size // columns_) for node in reversed(path)]
            row, column = divmod(i, columns_)
            cost = best[at]
            for dx, dy, step in STEPS:
                c, r = column + dx, row + dy
                if not (0 <= c < columns_ and 0 <= r < rows_):
                    continue
                j = r * columns_ + c
                after = layer * size + j
                if after in closed:
                    continue
                near = not reach or after in ends or after in starts
                owner = (hard_near if near else hard_reach)[layer][j]
                if owner != 0 and owner != net:
                    if near:
                        continue
                    # A wide track narrows between pads.
                    near, step = True, step + 1.0
                    owner = hard_near[layer][j]
                    if owner != 0 and owner != net:
                        continue
                count = foreign((soft_near if near else soft_reach)[layer].get(j))
                if count < 0:
                    continue
                total = cost + step + RIP_COST * count
                if total < best.get(after, 1e18):
                    best[after], came[after] = total, at
                    heapq.heappush(heap, (total + ahead(c, r), after))
            if not plane:
                count = via(i)
                if count >= 0:
                    total = cost + VIA_COST + RIP_COST * count
                    for other in range(LAYERS):
                        after = other * size + i
                        if other != layer and after not in closed and total < best.get(after, 1e18):
                            best[after], came[after] = total, at
                            heapq.heappush(heap, (total + ahead(column, row), after))
        return None

    def in_the_way(self, net: int, path: list[Node]) -> set[int]:
        reach = 1 if net in self.wide else 0
        found: set[int] = set()
        for before, (layer, column, row) in zip([None, *path], path):
            i = row * self.columns + column
            found |= self._blockers(net, layer, i, reach) or self._blockers(net, layer, i, 0) or set()
            if before is not None and before[0] != layer:
                for every in range(LAYERS):
                    found |= self._blockers(net, every, i, 1) or set()
        return found

    def lay(self, net: int, path: list[Node], plane: bool = False) -> Route:
        """Tracks and vias along a path, straight pieces joined."""
        route = Route(net)
        reach = 1 if net in self.wide else 0
        pieces: list[list[Node]] = [[path[0]]]
        for node in path[1:]:
            before = pieces[-1][-1]
            if node[0] != before[0]:
                route.vias.append((node[1] * GRID, node[2] * GRID))
                pieces.append([node])
            else:
                pieces[-1].append(node)
        if plane:
            route.vias.append((path[-1][1] * GRID, path[-1][2] * GRID))
        for piece in pieces:
            start = 0
            widths = [WIDE if reach and self._blockers(net, n[0], n[2] * self.columns + n[1], 1) == set() else TRACK for n in piece]
            for i in range(1, len(piece)):
                a, b = piece[i - 1], piece[i]
                follows = i + 1 < len(piece) and (piece[i + 1][1] - b[1], piece[i + 1][2] - b[2]) == (b[1] - a[1], b[2] - a[2])
                same = i + 1 < len(piece) and min(widths[i], widths[i + 1]) == min(widths[i - 1], widths[i])
                if not (follows and same):
                    route.tracks.append((
                        b[0], piece[start][1] * GRID, piece[start][2] * GRID, b[1] * GRID, b[2] * GRID, min(widths[i - 1], widths[i]),
                    ))
                    start = i
        # A via that the net has already serves again.
        route.vias = [via for via in route.vias if not any(via in other.vias for other in self.routes[net])]
        self.routes[net].append(route)
        self._mark(route, 1)
        return route

    def rip(self, net: int) -> None:
        for route in self.routes.pop(net, []):
            self._mark(route, -1)

    def _mark(self, route: Route, sign: int) -> None:
        for reach, distance in enumerate((NEAR, FAR)):
            for layer, x0, y0, x1, y1, width in route.tracks:
                self._capsule(layer, reach, route.net, x0, y0, x1, y1, distance + width / 2, sign)
            for x, y in route.vias:
                for layer in range(LAYERS):
                    self._capsule(layer, reach, route.net, x, y, x, y, distance + VIA / 2, sign)

    def _capsule(self, layer, reach, net, x0, y0, x1, y1, distance, sign) -> None:
        table = self.soft[layer][reach]
        dx, dy = x1 - x0, y1 - y0
        length = dx * dx + dy * dy
        for row in self._span(min(y0, y1) - distance, max(y0, y1) + distance, self.rows):
            y = row * GRID
            for column in self._span(min(x0, x1) - distance, max(x0, x1) + distance, self.columns):
                x = column * GRID
                t = 0.0 if length == 0 else min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / length))
                if (x - x0 - t * dx) ** 2 + (y - y0 - t * dy) ** 2 < distance * distance:
                    i = row * self.columns + column
                    owners = table[i]
                    owners[net] = owners.get(net, 0) + sign
                    if owners[net] == 0:
                        del owners[net]
                        if not owners:
                            del table[i]


def connect(router: Router, pads: dict[int, list[Rectangle]], plane_net: int, say=print) -> list[int]:
    """Routes all nets: short ones first, those of the plane as stubs to vias. Returns the nets that stay open."""
    for pad in pads[plane_net]:
        if len(pad.layers) < LAYERS:
            path = router.search(plane_net, router.nodes_of(pad), set(), False, plane=True)
            if path:
                router.lay(plane_net, path, plane=True)
            else:
                say(f"no via for a pad of the plane at {pad.left:.1f} {pad.top:.1f}")

    def span(net: int) -> float:
        xs, ys = [p.left for p in pads[net]], [p.top for p in pads[net]]
        return hypot(max(xs) - min(xs), max(ys) - min(ys)) * sqrt(len(pads[net]))

    queue = sorted((net for net in pads if net != plane_net and len(pads[net]) > 1), key=span)
    tries: dict[int, int] = defaultdict(int)
    open_nets: list[int] = []
    while queue:
        net = queue.pop(0)
        tries[net] += 1
        banned = frozenset({plane_net} | {other for other, count in tries.items() if count > 12})
        ripped = route_net(router, net, pads[net], banned)
        if sum(tries.values()) % 20 == 0 or ripped:
            say(f"{sum(tries.values())} nets routed, {len(queue)} to go, {len(ripped or ())} ripped up by net {net}")
        if ripped is None:
            open_nets.append(net)
            say(f"net {net} stays open")
        for other in ripped or ():
            router.rip(other)
        queue += sorted(ripped or (), key=span)
        if tries[net] > 30:
            break
    return open_nets


def route_net(router: Router, net: int, pads: list[Rectangle], banned: frozenset) -> set[int] | None:
    """Joins the pads one by one to what is joined already, the nearest first; the nets that must be ripped up."""
    router.rip(net)
    rest = list(pads[1:])
    joined = list(router.nodes_of(pads[0]))
    middles = [((pads[0].left + pads[0].right) / 2, (pads[0].top + pads[0].bottom) / 2)]
    ripped: set[int] = set()
    while rest:
        def distance(pad):
            x, y = (pad.left + pad.right) / 2, (pad.top + pad.bottom) / 2
            return min(hypot(x - mx, y - my) for mx, my in middles)
        rest.sort(key=distance)
        pad = rest.pop(0)
        goals = set(router.nodes_of(pad))
        path = router.search(net, joined, goals, False) or router.search(net, joined, goals, True, banned=banned)
        if path is None:
            return None
        ripped |= router.in_the_way(net, path)
        router.lay(net, path)
        joined += path + list(goals)
        middles.append(((pad.left + pad.right) / 2, (pad.top + pad.bottom) / 2))
        middles += [(c * GRID, r * GRID) for _, c, r in path[:: max(1, len(path) // 8)]]
    return ripped


def main(given: str, found: str) -> None:
    """A task as JSON in, routes as JSON out: both as `board.route` has them."""
    task = json.loads(Path(given).read_text())
    maze = Router(task["width"], task["height"], set(task["wide"]))
    pads: dict[int, list[Rectangle]] = {}
    for net, layers, *sides in task["pads"]:
        pad = Rectangle(net, tuple(layers), *sides)
        maze.pad(pad)
        if net > 0:
            pads.setdefault(net, []).append(pad)
    open_nets = connect(maze, pads, task["plane"], lambda text: print(text, flush=True))
    routes = [(item.net, item.tracks, item.vias) for items in maze.routes.values() for item in items]
    Path(found).write_text(json.dumps({"routes": routes, "open": open_nets}))


if __name__ == "__main__":
    main(*sys.argv[1:])
