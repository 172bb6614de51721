"""Arithmetic instructions as calls of the functions in machine/integers.h and machine/floats.h."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

from tests.ptx_machine.operands import CPP, Scope
from tests.ptx_machine.ptx import Instruction

Handler = Callable[[Instruction, Scope], str]
ROUNDINGS = {"rz": "FE_TOWARDZERO", "rm": "FE_DOWNWARD", "rp": "FE_UPWARD"}
FLOAT_TYPES = ("f32", "f64", "f32x2")


@dataclass(frozen=True)
class Integer:
    """The types of an instruction's operands and of its result: T its own, U u32, W twice T's width."""

    operands: str
    result: str = "T"

    def kind(self, code: str, own: str) -> str:
        """Return the type that a letter means in an instruction of the type `own`."""
        return {"T": own, "U": "u32", "W": f"{own[0]}{2 * int(own[1:])}" if own[1:].isdigit() else own}[code]


INTEGERS = {
    "add": Integer("TT"),
    "add.sat": Integer("TT"),
    "sub": Integer("TT"),
    "sub.sat": Integer("TT"),
    "mul.lo": Integer("TT"),
    "mul.hi": Integer("TT"),
    "mul.wide": Integer("TT", "W"),
    "mad.lo": Integer("TTT"),
    "mad.hi": Integer("TTT"),
    "mad.wide": Integer("TTW", "W"),
    "div": Integer("TT"),
    "rem": Integer("TT"),
    "neg": Integer("T"),
    "abs": Integer("T"),
    "sad": Integer("TTT"),
    "and": Integer("TT"),
    "or": Integer("TT"),
    "xor": Integer("TT"),
    "not": Integer("T"),
    "cnot": Integer("T"),
    "lop3": Integer("TTTU"),
    "shl": Integer("TU"),
    "shr": Integer("TU"),
    "prmt": Integer("TTT"),
    "popc": Integer("T", "U"),
    "clz": Integer("T", "U"),
    "brev": Integer("T"),
    "bfind": Integer("T", "U"),
    "bfind.shiftamt": Integer("T", "U"),
    "bfe": Integer("TUU"),
    "bfi": Integer("TTUU"),
}
CPP_WORDS = {"and": "and_", "or": "or_", "xor": "xor_", "not": "not_"}

DIRECTIONS = ("rn", *ROUNDINGS)
FLOATS: dict[str, Collection[str]] = {
    "add": (*DIRECTIONS, "ftz", "sat"),
    "sub": (*DIRECTIONS, "ftz", "sat"),
    "mul": (*DIRECTIONS, "ftz", "sat"),
    "fma": (*DIRECTIONS, "ftz", "sat"),
    "div": (*DIRECTIONS, "ftz", "approx", "full"),
    "rcp": (*DIRECTIONS, "ftz", "approx"),
    "sqrt": (*DIRECTIONS, "ftz", "approx"),
    "rsqrt": ("ftz", "approx"),
    "ex2": ("ftz", "approx"),
    "lg2": ("ftz", "approx"),
    "sin": ("ftz", "approx"),
    "cos": ("ftz", "approx"),
    "tanh": ("approx",),
    "min": ("ftz", "NaN"),
    "max": ("ftz", "NaN"),
    "abs": ("ftz",),
    "neg": ("ftz",),
    "copysign": (),
}


def assign(instruction: Instruction, scope: Scope, kind: str, value: str) -> str:
    """Give the destination's register a value of a PTX type."""
    return f"write<{CPP[kind]}>({scope.place(instruction, instruction.operands[0])}, {value});"


def arithmetic(instruction: Instruction, scope: Scope) -> str:
    """Translate add, mul, fma, min and the like, of whichever type."""
    handler = floating if instruction.modifiers[-1] in FLOAT_TYPES else integer
    return handler(instruction, scope)


def integer(instruction: Instruction, scope: Scope) -> str:
    *forms, kind = instruction.modifiers
    name = ".".join((instruction.opcode, *forms))
    if name in ("min", "max"):
        signature = Integer("T" * (len(instruction.operands) - 1))
    elif name in INTEGERS:
        signature = INTEGERS[name]
    else:
        raise instruction.refuse(f"{name} of integers is not known")
    if kind not in CPP or len(instruction.operands) != 1 + len(signature.operands):
        raise instruction.refuse(f"{name} is known of {len(signature.operands)} operands of one type")
    values = [
        scope.value(instruction, operand, signature.kind(code, kind))
        for operand, code in zip(instruction.operands[1:], signature.operands, strict=True)
    ]
    function = CPP_WORDS.get(name, name.replace(".", "_"))
    return assign(instruction, scope, signature.kind(signature.result, kind), f"{function}({', '.join(values)})")


def floating(instruction: Instruction, scope: Scope) -> str:
    *modifiers, kind = instruction.modifiers
    unknown = set(modifiers) - set(FLOATS.get(instruction.opcode, ()))
    if instruction.opcode not in FLOATS or unknown:
        raise instruction.refuse(f"{instruction.opcode} of floats is not known with {unknown or 'anything'}")
    values = [scope.value(instruction, operand, kind) for operand in instruction.operands[1:]]
    if "ftz" in modifiers:
        values = [f"flush({value})" for value in values]
    function = instruction.opcode + "".join(f"_{form}" for form in ("approx", "full") if form in modifiers)
    function += "_nan" if "NaN" in modifiers else ""
    values[:0] = [ROUNDINGS[modifier] for modifier in modifiers if modifier in ROUNDINGS]
    call = f"{function}({', '.join(values)})"
    for modifier, around in (("ftz", "flush"), ("sat", "saturate")):
        call = f"{around}({call})" if modifier in modifiers else call
    return assign(instruction, scope, kind, call)


def multiply_add(instruction: Instruction, scope: Scope) -> str:
    """Translate mad, which of floats is fma by another name."""
    if instruction.modifiers[-1] not in FLOAT_TYPES:
        return integer(instruction, scope)
    fma = Instruction(
        instruction.line, instruction.text, None, False, "fma", instruction.modifiers, instruction.operands
    )
    return floating(fma, scope)


def funnel_shift(instruction: Instruction, scope: Scope) -> str:
    """Translate shf.l.wrap.b32 d, low, high, amount."""
    direction, mode, _ = instruction.modifiers
    values = [scope.value(instruction, operand, "u32") for operand in instruction.operands[1:]]
    wrap = "true" if mode == "wrap" else "false"
    return assign(instruction, scope, "u32", f"shf_{direction}({', '.join(values)}, {wrap})")


def bit_mask(instruction: Instruction, scope: Scope) -> str:
    """Translate bmsk.clamp.b32 d, position, length."""
    values = [scope.value(instruction, operand, "u32") for operand in instruction.operands[1:]]
    wrap = "true" if instruction.modifiers[0] == "wrap" else "false"
    return assign(instruction, scope, "u32", f"bmsk({', '.join(values)}, {wrap})")


OPCODES = {name.partition(".")[0] for name in (*INTEGERS, *FLOATS)} - {"mad"}
HANDLERS: dict[str, Handler] = {
    **dict.fromkeys(OPCODES, arithmetic),
    "mad": multiply_add,
    "shf": funnel_shift,
    "bmsk": bit_mask,
}
