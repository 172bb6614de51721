"""Branches and ends."""

from __future__ import annotations

from tests.ptx_machine.arithmetic import Handler
from tests.ptx_machine.operands import Scope
from tests.ptx_machine.ptx import BranchTargets, Instruction


def label_name(name: str) -> str:
    """Return a label as C++ takes it."""
    return "label_" + name.replace("$", "_S")


def branch(instruction: Instruction, scope: Scope) -> str:
    """Translate bra target, and brx.idx index, table."""
    if instruction.modifiers != ("idx",) and instruction.opcode == "bra":
        return f"goto {label_name(instruction.operands[0])};"
    index, name = instruction.operands[:2]
    tables = [s for s in scope.kernel.statements if isinstance(s, BranchTargets) and s.name == name]
    if not tables:
        raise instruction.refuse(f"there is no table {name}")
    cases = [f"case {i}: goto {label_name(label)};" for i, label in enumerate(tables[0].labels)]
    return f"switch ({scope.value(instruction, index, 'u32')}) {{ {' '.join(cases)} }}"


def leave(instruction: Instruction, scope: Scope) -> str:
    """Translate ret and exit."""
    return "return false;"


def trap(instruction: Instruction, scope: Scope) -> str:
    return f'throw Fault("trap" + at({instruction.line}) + " (" + who(thread) + ")");'


def active_mask(instruction: Instruction, scope: Scope) -> str:
    """Translate activemask: each lane is on its own here, as lanes may be anywhere on a GPU."""
    return f"write<uint32_t>({scope.place(instruction, instruction.operands[0])}, 1u << lane_of(thread));"


def nothing(instruction: Instruction, scope: Scope) -> str:
    """Translate nanosleep and fences to nothing: they order nothing that the watch of memory takes for ordered."""
    return ";"


HANDLERS: dict[str, Handler] = {
    "bra": branch,
    "brx": branch,
    "ret": leave,
    "exit": leave,
    "trap": trap,
    "activemask": active_mask,
    "nanosleep": nothing,
    "membar": nothing,
    "fence": nothing,
}
