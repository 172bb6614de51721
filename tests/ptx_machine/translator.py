"""Translate PTX to C++ for machine/machine.h: a function for each kernel, which returns wherever threads meet."""

from __future__ import annotations

from tests.ptx_machine import accesses, arithmetic, flow, meetings, selections
from tests.ptx_machine.accesses import Access
from tests.ptx_machine.arithmetic import Handler
from tests.ptx_machine.flow import label_name
from tests.ptx_machine.operands import REGISTER_BYTES, Scope, member_name, variable_name
from tests.ptx_machine.ptx import (
    BYTES,
    BranchTargets,
    Instruction,
    Kernel,
    Label,
    Module,
    PtxError,
    Registers,
    Statement,
    Variable,
    parse,
)

HANDLERS: dict[str, Handler] = {
    **arithmetic.HANDLERS,
    **selections.HANDLERS,
    **accesses.HANDLERS,
    **flow.HANDLERS,
}
MOST_LINES = 2**16 - 1  # that an access of machine/shadow.h can name


def translate(text: str) -> str:
    """Return the C++ of a PTX module.

    Raises PtxError for an instruction that is not known, with its line.
    """
    if text.count("\n") >= MOST_LINES:
        raise PtxError(f"the PTX has {text.count(chr(10))} lines: expected less than {MOST_LINES}")
    module = parse(text)
    kernels = [_Translation(kernel, module) for kernel in module.kernels]
    parts = ['#include "machine.h"', "namespace ptx {", *_variables(module)]
    parts += [part for kernel in kernels for part in kernel.code()]
    rows = [kernel.table_row() for kernel in kernels]
    parts += ["const Kernel kernels[] = {", *rows, "  {},\n};", "}  // namespace ptx"]
    return "\n".join(parts) + "\n"


def _variables(module: Module) -> list[str]:
    """Return the module's variables in global and constant memory, and the table of them."""
    kept = {name: v for name, v in module.variables.items() if v.space in ("global", "const")}
    made = [f"alignas(16) static unsigned char {variable_name(name)}[] = {{{_bytes(v)}}};" for name, v in kept.items()]
    rows = [f"  {{uint64_t({variable_name(name)}), {v.size}}}," for name, v in kept.items()]
    return [*made, "const Range variables[] = {", *rows, "  {0, 0},\n};"]


def _bytes(variable: Variable) -> str:
    return ", ".join(map(str, variable.data))


class _Translation:
    """The translation of one kernel."""

    def __init__(self, kernel: Kernel, module: Module) -> None:
        self._kernel, self._scope = kernel, Scope(kernel, module)
        self._meetings = 0

    def code(self) -> list[str]:
        name = self._kernel.name
        body = [self._statement(statement) for statement in self._kernel.statements]
        members = [self._member(name, registers) for name, registers in self._kernel.registers.items()]
        arrays = [f"  {{{offset}, {size}}}," for offset, size in self._scope.shared.values()]
        return [
            f"struct Registers_{name} {{",
            *members,
            "};",
            f"static bool run_{name}(Thread& thread) {{",
            f"  [[maybe_unused]] Registers_{name}& R = *static_cast<Registers_{name}*>(thread.registers);",
            "  switch (thread.resume) { case 0:;",
            *body,
            "  }",
            "  return false;",
            "}",
            f"static const Range shared_{name}[] = {{",
            *arrays,
            "  {0, 0},\n};",
        ]

    @staticmethod
    def _member(name: str, registers: Registers) -> str:
        size = REGISTER_BYTES.get(registers.kind)
        if size is None:
            raise PtxError(f"registers of .{registers.kind} ({name}): tests/ptx_machine does not execute these")
        cpp = "bool" if registers.kind == "pred" else f"uint{8 * size}_t"
        return f"  {cpp} {member_name(name)}{'' if registers.count is None else f'[{registers.count}]'};"

    def _statement(self, statement: Statement) -> str:
        if isinstance(statement, Label):
            return f"  {label_name(statement.name)}:;"
        if isinstance(statement, BranchTargets):
            return ""
        action = self._meeting(statement) if statement.opcode in meetings.HANDLERS else self._action(statement)
        if statement.predicate is None:
            return f"  {action}"
        predicate = self._scope.value(statement, statement.predicate, "pred")
        return f"  if ({'!' if statement.negated else ''}{predicate}) {{ {action} }}"

    def _action(self, instruction: Instruction) -> str:
        handler = HANDLERS.get(instruction.opcode)
        if handler is None:
            raise instruction.refuse(f"the instruction {instruction.opcode} is not known")
        return self._handled(handler, instruction)

    def _meeting(self, instruction: Instruction) -> str:
        self._meetings += 1
        go = self._handled(meetings.HANDLERS[instruction.opcode], instruction)
        return f"{go} thread.resume = {self._meetings}; return true; case {self._meetings}:;"

    def _handled(self, handler: Handler, instruction: Instruction) -> str:
        """Translate an instruction; one of another form than its handler reads is refused as well."""
        try:
            return handler(instruction, self._scope)
        except (KeyError, IndexError, ValueError) as error:
            raise instruction.refuse(f"this form is not known ({error!r})") from error

    def table_row(self) -> str:
        name, scope = self._kernel.name, self._scope
        sizes = [
            f"sizeof(Registers_{name})",
            str(scope.shared_bytes),
            str(scope.local_bytes),
            str(self._kernel.parameter_bytes),
            str(self._kernel.most_threads),
            str(self._smallest_access("global")),
            str(self._smallest_access("shared")),
        ]
        return f'  {{"{name}", run_{name}, {", ".join(sizes)}, shared_{name}, {len(scope.shared)}}},'

    def _smallest_access(self, space: str) -> int:
        """Return the bytes of the smallest access that may be of a space; 4 where there are none."""
        moves = [s for s in self._kernel.statements if isinstance(s, Instruction) and s.opcode in ("ld", "ldu", "st")]
        kinds = [(access.space, access.kind) for access in map(Access.of, moves)]
        return min((BYTES[kind] for where, kind in kinds if where in (space, "generic")), default=4)
