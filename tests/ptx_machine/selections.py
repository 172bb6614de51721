"""Comparisons, choices, moves and conversions."""

from __future__ import annotations

from tests.ptx_machine.arithmetic import FLOAT_TYPES, ROUNDINGS, Handler, assign
from tests.ptx_machine.operands import CPP, REGISTER_BYTES, Scope, vector
from tests.ptx_machine.ptx import Instruction

COMPARISONS: tuple[str, ...] = ("eq", "ne", "lt", "le", "gt", "ge", "lo", "ls", "hi", "hs")
COMPARISONS += ("equ", "neu", "ltu", "leu", "gtu", "geu", "num", "nan")
COMBINED = {"and": "{} && {}", "or": "{} || {}", "xor": "{} != {}"}
TO_WHOLE = ("rni", "rzi", "rmi", "rpi")


def compared(instruction: Instruction, scope: Scope, modifiers: list[str], kind: str) -> tuple[str, str]:
    """Return what `.lt.and.ftz` makes of operands a, b and the predicate c, and what the opposite comparison makes."""
    comparison, *rest = modifiers
    combined = [modifier for modifier in rest if modifier in COMBINED]
    if comparison not in COMPARISONS or set(rest) - {*COMBINED, "ftz"}:
        raise instruction.refuse(f"the comparison {'.'.join(modifiers)} is not known")
    a, b = (scope.value(instruction, operand, kind) for operand in instruction.operands[1:3])
    if "ftz" in rest:
        a, b = f"flush({a})", f"flush({b})"
    call = f"{comparison}({a}, {b})"
    if not combined:
        return call, f"!{call}"
    other = scope.value(instruction, instruction.operands[3], "pred")
    return COMBINED[combined[0]].format(call, other), COMBINED[combined[0]].format(f"!{call}", other)


def set_predicate(instruction: Instruction, scope: Scope) -> str:
    """Translate setp.lt.and.f32 p|q, a, b, c."""
    *modifiers, kind = instruction.modifiers
    results = compared(instruction, scope, modifiers, kind)
    places = [part.strip() for part in instruction.operands[0].split("|")]
    names = [f"const bool result{i} = {result};" for i, result in enumerate(results[: len(places)])]
    writes = [f"{scope.place(instruction, p)} = result{i};" for i, p in enumerate(places) if p != "_"]
    return f"{{ {' '.join(names + writes)} }}"


def set_number(instruction: Instruction, scope: Scope) -> str:
    """Translate set.lt.u32.f32 d, a, b: all ones, or 1.0f in a float."""
    *modifiers, to, kind = instruction.modifiers
    true = "1.0f" if to == "f32" else f"{CPP[to]}(-1)"
    result, _ = compared(instruction, scope, modifiers, kind)
    return assign(instruction, scope, to, f"({result}) ? {true} : {CPP[to]}(0)")


def select(instruction: Instruction, scope: Scope) -> str:
    """Translate selp.f32 d, a, b, p."""
    kind = instruction.modifiers[-1]
    a, b = (scope.value(instruction, operand, kind) for operand in instruction.operands[1:3])
    return assign(instruction, scope, kind, f"{scope.value(instruction, instruction.operands[3], 'pred')} ? {a} : {b}")


def select_by_sign(instruction: Instruction, scope: Scope) -> str:
    """Translate slct.f32.s32 d, a, b, c: a where c >= 0."""
    *_, kind, sign = instruction.modifiers
    a, b = (scope.value(instruction, operand, kind) for operand in instruction.operands[1:3])
    decides = scope.value(instruction, instruction.operands[3], sign)
    return assign(instruction, scope, kind, f"{decides} >= 0 ? {a} : {b}")


def move(instruction: Instruction, scope: Scope) -> str:
    """Translate mov.b32 d, a; mov.b64 {low, high}, a; mov.b64 d, {low, high}."""
    to, source = instruction.operands
    kind = instruction.modifiers[-1]
    if to.startswith("{"):
        return _unpack(instruction, scope, vector(to), scope.value(instruction, source, kind))
    if source.startswith("{"):
        return assign(instruction, scope, kind, _packed(instruction, scope, vector(source), kind))
    return assign(instruction, scope, kind, scope.value(instruction, source, kind))


def _bits_each(kind: str, parts: list[str]) -> int:
    return 8 * REGISTER_BYTES[kind] // len(parts)


def _packed(instruction: Instruction, scope: Scope, parts: list[str], kind: str) -> str:
    bits = _bits_each(kind, parts)
    values = [f"uint64_t({scope.value(instruction, part, f'b{bits}')}) << {i * bits}" for i, part in enumerate(parts)]
    return f"{CPP[kind]}({' | '.join(f'({value})' for value in values)})"


def _unpack(instruction: Instruction, scope: Scope, parts: list[str], whole: str) -> str:
    kind = instruction.modifiers[-1]
    bits = _bits_each(kind, parts)
    writes = [
        f"write<uint{bits}_t>({scope.place(instruction, part)}, uint{bits}_t(whole >> {i * bits}));"
        for i, part in enumerate(parts)
        if part != "_"
    ]
    return f"{{ const uint64_t whole = {whole}; {' '.join(writes)} }}"


def convert(instruction: Instruction, scope: Scope) -> str:
    """Translate cvt.rzi.s32.f32 and its many forms."""
    *modifiers, to, source = instruction.modifiers
    known = {"ftz", "sat", "rn", *TO_WHOLE, *ROUNDINGS}
    if to not in CPP or source not in CPP or set(modifiers) - known:
        raise instruction.refuse("this conversion is not known")
    value = scope.value(instruction, instruction.operands[1], source)
    if "ftz" in modifiers and source == "f32":
        value = f"flush({value})"
    value = _converted(modifiers, to, source, value)
    if "ftz" in modifiers and to == "f32":
        value = f"flush({value})"
    return assign(instruction, scope, to, value)


def _converted(modifiers: list[str], to: str, source: str, value: str) -> str:
    whole = next((modifier for modifier in modifiers if modifier in TO_WHOLE), None)
    direction = next((ROUNDINGS[modifier] for modifier in modifiers if modifier in ROUNDINGS), None)
    if whole:
        value = f"{whole}({value})"
    if source in FLOAT_TYPES and to not in FLOAT_TYPES:
        return f"to_integer<{CPP[to]}>({value})"  # saturates with and without .sat
    if "sat" in modifiers:
        return f"convert_sat<{CPP[to]}>({value})"
    return f"convert<{CPP[to]}>({f'{direction}, ' if direction else ''}{value})"


HANDLERS: dict[str, Handler] = {
    "setp": set_predicate,
    "set": set_number,
    "selp": select,
    "slct": select_by_sign,
    "mov": move,
    "cvt": convert,
}
