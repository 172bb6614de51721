"""Read the machine code of CUDA kernels: their instructions by loop, and the registers and memory they take."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

INSTRUCTION = re.compile(r"^\s*/\*([0-9a-f]+)\*/\s+(?:@(!?U?P\w+)\s+)?([A-Z0-9_.]+)(.*?);")
LABEL = re.compile(r"^(\.L_x_\d+):")
TARGET = re.compile(r"\(?(\.L_x_\d+)\)?")
KERNEL = re.compile(r"^\.text\.(\w+):")
RESOURCES = re.compile(r"Function (\w+):\s*\n\s*REG:(\d+) STACK:(\d+) SHARED:(\d+)")
ENDS = ("EXIT", "RET", "BRX", "JMP")  # after which nothing follows unless they are predicated
DOUBLE = re.compile(r"^(DADD|DMUL|DFMA|DSETP|DMNMX|MUFU\.\w+64H)")


@dataclass(frozen=True)
class Instruction:
    """One instruction; guarded: whether a predicate decides if it acts; target: the label that it may jump to."""

    name: str
    guarded: bool
    target: str | None


@dataclass
class Block:
    """Instructions that are run together, and the blocks that may follow."""

    code: list[Instruction]
    following: list[int] = field(default_factory=list)


@dataclass
class Loop:
    """A loop by its own instructions, those of loops inside it left out.

    always: run at every turn; sometimes: in parts that a branch may leave out; doubles: those in float64, likewise.
    Kernels, too, are loops here, of one turn.
    """

    always: int
    sometimes: int
    exponentials: int
    always_doubles: int
    sometimes_doubles: int
    inner: list[Loop]

    def all_inner(self) -> list[Loop]:
        """Return this loop and all inside it."""
        return [self, *(deeper for loop in self.inner for deeper in loop.all_inner())]

    def at(self, share: float) -> float:
        """Return the instructions a turn, when that share of turns enters the parts that may be left out."""
        return self.always + share * self.sometimes


@dataclass(frozen=True)
class Resources:
    """The resources of a kernel: registers a thread; bytes of stack a thread and of shared memory a block."""

    registers: int
    stack: int
    shared: int


def disassemble(cubin: Path, nvdisasm: str) -> dict[str, str]:
    """Return the machine code's text, by kernel."""
    text = subprocess.run([nvdisasm, "-c", str(cubin)], check=True, capture_output=True, text=True).stdout
    kernels: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if found := KERNEL.match(line):
            lines = kernels.setdefault(found[1], [])
        lines.append(line)
    return {name: "\n".join(lines) for name, lines in kernels.items()}


def resources(cubin: Path, cuobjdump: str) -> dict[str, Resources]:
    """Return what each kernel of a cubin takes."""
    text = subprocess.run([cuobjdump, "--dump-resource-usage", str(cubin)], check=True, capture_output=True, text=True)
    return {name: Resources(*map(int, numbers)) for name, *numbers in RESOURCES.findall(text.stdout)}


def loops_of(text: str) -> Loop:
    """Return a kernel's loops, from the jumps of its machine code.

    Left out: parts that nothing but a call or a jump for diverged warps leads to, and parts that call (slow ways of
    division and roots, for numbers that hardly occur).
    """
    blocks = _blocks(text)
    rulers = _dominators(blocks)
    members: dict[int, set[int]] = {0: set(rulers)}
    latches: dict[int, set[int]] = {}
    for index in rulers:
        for head in blocks[index].following:
            if head in rulers[index]:
                members[head] = members.get(head, {head}) | _natural_loop(blocks, rulers, index, head)
                latches.setdefault(head, set()).add(index)
    return _tree(blocks, rulers, members, latches)


def _blocks(text: str) -> list[Block]:
    """Return the kernel's blocks in their order, with what follows each."""
    blocks, starts = [Block([])], {}
    for line in text.splitlines():
        if label := LABEL.match(line):
            if blocks[-1].code:
                blocks.append(Block([]))
            starts[label[1]] = len(blocks) - 1
        elif found := INSTRUCTION.match(line):
            target = TARGET.search(found[4]) if found[3].startswith("BRA") else None
            blocks[-1].code.append(Instruction(found[3], found[2] is not None, target[1] if target else None))
            if found[3].startswith(("BRA", *ENDS)):
                blocks.append(Block([]))
    for index, block in enumerate(blocks):
        block.following = _following(block, index, len(blocks), starts)
    return blocks


def _following(block: Block, index: int, count: int, starts: dict[str, int]) -> list[int]:
    if not block.code:
        return [index + 1] if index + 1 < count else []
    last = block.code[-1]
    follows = [] if last.name.startswith(("BRA", *ENDS)) and not last.guarded else [index + 1]
    if last.name.startswith("BRA.DIV"):
        follows = [index + 1]
    elif last.target in starts:
        follows.append(starts[last.target])
    return [other for other in follows if other < count]


def _dominators(blocks: list[Block]) -> dict[int, set[int]]:
    """Return for each block that can be reached the blocks on every way to it, itself among them."""
    reached, waiting = {0}, [0]
    while waiting:
        for other in blocks[waiting.pop()].following:
            if other not in reached:
                reached.add(other)
                waiting.append(other)
    before: dict[int, list[int]] = {index: [] for index in reached}
    for index in reached:
        for other in blocks[index].following:
            before[other].append(index)
    rulers = {index: set(reached) for index in reached}
    rulers[0] = {0}
    changed = True
    while changed:
        changed = False
        for index in sorted(reached - {0}):
            found = {index} | set.intersection(*(rulers[other] for other in before[index]))
            changed |= found != rulers[index]
            rulers[index] = found
    return rulers


def _natural_loop(blocks: list[Block], reached: dict[int, set[int]], latch: int, head: int) -> set[int]:
    loop, waiting = {head}, [latch]
    while waiting:
        index = waiting.pop()
        if index not in loop:
            loop.add(index)
            waiting += [other for other in reached if index in blocks[other].following]
    return loop


def _tree(
    blocks: list[Block], rulers: dict[int, set[int]], members: dict[int, set[int]], latches: dict[int, set[int]]
) -> Loop:
    """Arrange loops inside loops.

    The kernel is the loop of block 0; what leads to its last end is always run.
    """
    ends = {index for index in members[0] if any(c.name.startswith("EXIT") for c in blocks[index].code)}
    latches = {0: {max(ends)}, **latches}
    heads = sorted(members, key=lambda head: len(members[head]))
    loops: dict[int, Loop] = {}
    for head in heads:
        inside = [other for other in loops if other != head and other in members[head]]
        taken = set().union(*(members[other] for other in inside))
        outermost = [o for o in inside if not any(o != p and o in members[p] for p in inside)]
        always = set.intersection(*(rulers[latch] for latch in latches[head]))
        own = Loop(0, 0, 0, 0, 0, [loops[other] for other in outermost])
        for index in members[head] - taken:
            _add(own, blocks[index].code, index in always)
        loops[head] = own
    return loops[0]


def _add(loop: Loop, code: list[Instruction], always: bool) -> None:
    if any(c.name.startswith("CALL") for c in code) and not always:
        return
    count, doubles = sum(c.name != "NOP" for c in code), sum(bool(DOUBLE.match(c.name)) for c in code)
    exponentials = sum(c.name == "MUFU.EX2" for c in code)
    loop.exponentials += exponentials
    # A turn is what evaluates a splat at a pixel, even where a branch is before that.
    if always or exponentials:
        loop.always, loop.always_doubles = loop.always + count, loop.always_doubles + doubles
    else:
        loop.sometimes, loop.sometimes_doubles = loop.sometimes + count, loop.sometimes_doubles + doubles
