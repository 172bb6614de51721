"""Loads, stores and the spaces that addresses are of."""

from __future__ import annotations

from dataclasses import dataclass

from tests.ptx_machine.arithmetic import Handler
from tests.ptx_machine.operands import CPP, Address, Scope, vector
from tests.ptx_machine.ptx import BYTES, Instruction

SPACES = {"global": "global", "const": "global", "shared": "shared", "local": "local", "param": "param"}
HINTS = ("volatile", "weak", "nc", "ca", "cg", "cs", "lu", "cv", "wb", "wt", "cta", "uni")


@dataclass(frozen=True)
class Access:
    """A load or store: its space (generic where none is named), and of what it moves `count` at once."""

    space: str
    kind: str
    count: int

    @classmethod
    def of(cls, instruction: Instruction) -> Access:
        *modifiers, kind = instruction.modifiers
        space, count = "generic", 1
        for modifier in modifiers:
            name = modifier.partition("::")[0]
            if name in SPACES:
                space = SPACES[name]
            elif modifier in ("v2", "v4", "v8"):
                count = int(modifier[1:])
            elif name not in (*HINTS, "L1", "L2", "level"):
                raise instruction.refuse(f".{modifier} is not known")
        if kind not in CPP:
            raise instruction.refuse(f"memory of .{kind} is not known")
        return cls(space, kind, count)

    def place(self, instruction: Instruction, address: Address, kind: str) -> str:
        size = self.count * BYTES[self.kind]
        return f"{self.space}_at(thread, {address}, {size}, Kind::{kind}, {instruction.line})"


def load(instruction: Instruction, scope: Scope) -> str:
    """Translate a load, such as ld.global.nc.v4.f32 {a, b, c, d}, [address]."""
    access = Access.of(instruction)
    place = access.place(instruction, scope.address(instruction, instruction.operands[1]), "kRead")
    cpp = CPP[access.kind]
    writes = [
        f"write<{cpp}>({scope.place(instruction, register)}, load_bytes<{cpp}>(from, {i}));"
        for i, register in enumerate(vector(instruction.operands[0]))
        if register != "_"
    ]
    return f"{{ const unsigned char* from = {place}; {' '.join(writes)} }}"


def store(instruction: Instruction, scope: Scope) -> str:
    """Translate a store, such as st.shared.v2.f32 [address], {a, b}."""
    access = Access.of(instruction)
    place = access.place(instruction, scope.address(instruction, instruction.operands[0]), "kWrite")
    writes = [
        f"store_bytes<{CPP[access.kind]}>(to, {i}, {scope.value(instruction, value, access.kind)});"
        for i, value in enumerate(vector(instruction.operands[1]))
    ]
    return f"{{ unsigned char* to = {place}; {' '.join(writes)} }}"


def convert_address(instruction: Instruction, scope: Scope) -> str:
    """Translate cvta.to.shared.u64 d, a, and without `to` the other way.

    All spaces but shared memory have generic addresses.
    """
    space = instruction.modifiers[1] if instruction.modifiers[0] == "to" else instruction.modifiers[0]
    if space not in SPACES:
        raise instruction.refuse(f"the space .{space} is not known")
    value = scope.value(instruction, instruction.operands[1], "u64")
    if space == "shared":
        value = f"{'shared_of_generic' if instruction.modifiers[0] == 'to' else 'generic_of_shared'}({value})"
    return f"write<uint64_t>({scope.place(instruction, instruction.operands[0])}, {value});"


def prefetch(instruction: Instruction, scope: Scope) -> str:
    """Translate to nothing: it changes nothing that can be seen."""
    return ";"


HANDLERS: dict[str, Handler] = {
    "ld": load,
    "ldu": load,
    "st": store,
    "cvta": convert_address,
    "prefetch": prefetch,
    "prefetchu": prefetch,
}
