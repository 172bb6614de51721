"""Operands of PTX as C++ expressions."""

from __future__ import annotations

import re
from dataclasses import dataclass

from tests.ptx_machine.ptx import BYTES, Instruction, Kernel, Module, Registers, Variable

CPP = {f"{kind}{bits}": f"{'int' if kind == 's' else 'uint'}{bits}_t" for kind in "bsu" for bits in (8, 16, 32, 64)}
CPP |= {"pred": "bool", "f32": "float", "f64": "double", "f32x2": "FloatPair"}
SPECIAL = {
    "%tid.x": "thread.index",
    "%ctaid.x": "thread.block",
    "%ntid.x": "machine.threads",
    "%nctaid.x": "machine.blocks",
    "%laneid": "lane_of(thread)",
    "%warpid": "(thread.index / kWarp)",
    "%lanemask_eq": "(1u << lane_of(thread))",
    "%lanemask_lt": "((1u << lane_of(thread)) - 1)",
    "%lanemask_le": "((2u << lane_of(thread)) - 1)",
    "%lanemask_gt": "~((2u << lane_of(thread)) - 1)",
    "%lanemask_ge": "~((1u << lane_of(thread)) - 1)",
    "WARP_SZ": "kWarp",
}
SPECIAL |= {f"%{name}.{axis}": value for name, value in (("tid", "0u"), ("ctaid", "0u")) for axis in "yz"}
SPECIAL |= {f"%{name}.{axis}": "1u" for name in ("ntid", "nctaid") for axis in "yz"}
REGISTER_BYTES = {**BYTES, "pred": 1}
RED_ZONE = 16  # bytes between the arrays of shared memory, and at their end


@dataclass(frozen=True)
class Address:
    """`[base+offset]`: base as a C++ expression of 64 bits."""

    base: str
    offset: int

    def __str__(self) -> str:
        return f"{self.base} + {self.offset}" if self.offset >= 0 else f"{self.base} - {-self.offset}"


class Scope:
    """What the names in a kernel's instructions mean."""

    def __init__(self, kernel: Kernel, module: Module) -> None:
        self.kernel = kernel
        own_names = {name for name in module.variables if self._mentions(kernel, name)}
        visible = {**{name: module.variables[name] for name in own_names}, **kernel.variables}
        self.shared = self._lay_out({name: v for name, v in visible.items() if v.space == "shared"})
        self.local = self._lay_out({name: v for name, v in visible.items() if v.space == "local"}, zone=0)
        self.module_variables = {name for name, v in visible.items() if v.space in ("global", "const")}

    @staticmethod
    def _mentions(kernel: Kernel, name: str) -> bool:
        word = re.compile(rf"(?<![\w$%]){re.escape(name)}(?![\w$])")
        return any(isinstance(s, Instruction) and word.search(s.text) for s in kernel.statements)

    @staticmethod
    def _lay_out(variables: dict[str, Variable], zone: int = RED_ZONE) -> dict[str, tuple[int, int]]:
        """Return the offset and size of each variable.

        Offsets are multiples of 128, as wide as a shared access can be.
        """
        places, at = {}, 0
        for name, variable in variables.items():
            places[name] = (at, variable.size)
            at += -(-(variable.size + zone) // 128) * 128
        return places

    @property
    def shared_bytes(self) -> int:
        return max((offset + size + RED_ZONE for offset, size in self.shared.values()), default=0)

    @property
    def local_bytes(self) -> int:
        return max((offset + size for offset, size in self.local.values()), default=0)

    def register(self, operand: str) -> tuple[str, Registers] | None:
        """Return the C++ place of a register and its declaration; None for what is no register."""
        registers = self.kernel.registers
        if operand in registers and registers[operand].count is None:
            return f"R.{member_name(operand)}", registers[operand]
        match = re.fullmatch(r"(.*?)(\d+)", operand)
        while match:  # %rd1 is register 1 of %rd; of names that end in digits themselves, the longest counts
            declared = registers.get(match[1])
            if declared and declared.count is not None and int(match[2]) < declared.count:
                return f"R.{member_name(match[1])}[{match[2]}]", declared
            match = re.fullmatch(rf"({re.escape(match[1])}\d)(\d+)", operand)
        return None

    def place(self, instruction: Instruction, operand: str) -> str:
        """Return a register as what can be assigned to."""
        found = self.register(operand)
        if found is None:
            raise instruction.refuse(f"`{operand}` is no register")
        return found[0]

    def place_or_null(self, instruction: Instruction, operand: str | None) -> str:
        """Return a register's address; of none, or the sink `_`, a null pointer."""
        return "nullptr" if operand in (None, "_") else f"&{self.place(instruction, str(operand))}"

    def value(self, instruction: Instruction, operand: str, kind: str) -> str:
        """Return an operand read as a PTX type."""
        cpp = CPP[kind]
        if operand in SPECIAL:
            return f"read<{cpp}>(uint32_t({SPECIAL[operand]}))"
        if operand.startswith("!"):
            return f"!{self.value(instruction, operand[1:], kind)}"
        if found := self.register(operand):
            return found[0] if kind == "pred" else f"read<{cpp}>({found[0]})"
        if re.fullmatch(r"0[fF][0-9A-Fa-f]{8}", operand):
            return f"read<{cpp}>(uint32_t(0x{operand[2:]}u))"
        if re.fullmatch(r"0[dD][0-9A-Fa-f]{16}", operand):
            return f"read<{cpp}>(uint64_t(0x{operand[2:]}ull))"
        if re.fullmatch(r"-?(0[xX][0-9A-Fa-f]+|\d+)U?", operand):
            number = int(operand.rstrip("U"), 0)
            return ("true" if number else "false") if kind == "pred" else f"{cpp}({number % 2**64}ull)"
        return f"{cpp}({self.symbol(instruction, operand)})"

    def symbol(self, instruction: Instruction, name: str) -> str:
        """Return the address of a variable or of the parameters, in its own space."""
        if name in self.shared:
            return f"uint64_t({self.shared[name][0]})"
        if name == self.kernel.parameter:
            return "uint64_t(memory.params)"
        if name in self.local:
            return f"(uint64_t(thread.local) + {self.local[name][0]})"
        if name in self.module_variables:
            return f"uint64_t({variable_name(name)})"
        raise instruction.refuse(f"`{name}` is not known")

    def address(self, instruction: Instruction, operand: str) -> Address:
        match = re.fullmatch(r"\[\s*([^+\s\]]+)\s*(?:\+\s*(-?\d+)\s*)?\]", operand)
        if not match:
            raise instruction.refuse(f"`{operand}` is no address")
        found = self.register(match[1])
        base = f"uint64_t({found[0]})" if found else self.symbol(instruction, match[1])
        return Address(base, int(match[2] or 0))


def member_name(register: str) -> str:
    """Return a register's name as C++ takes it."""
    return re.sub(r"\W", "_", register.removeprefix("%")) + ("_" if register[-1] not in "0123456789" else "")


def variable_name(name: str) -> str:
    """Return a module's variable as C++ takes it."""
    return "variable_" + name.replace("$", "_S")


def vector(operand: str) -> list[str]:
    """Return the registers of `{%f1, %f2}`, or the one there is."""
    return [part.strip() for part in operand.strip("{}").split(",")]
