"""Instructions at which threads meet: barriers, shuffles, votes. The kernel's function returns there, and goes on from
a `case` of its own once the others have come."""

from __future__ import annotations

from collections.abc import Callable

from tests.ptx_machine.operands import Scope
from tests.ptx_machine.ptx import Instruction

MeetingHandler = Callable[[Instruction, Scope], str]
SHUFFLES = {"up": "kShuffleUp", "down": "kShuffleDown", "bfly": "kShuffleXor", "idx": "kShuffleIndex"}
VOTES = {"all": "kVoteAll", "any": "kVoteAny", "uni": "kVoteUniform", "ballot": "kBallot"}
COUNTS = {"popc": "kBarrierPopc", "and": "kBarrierAnd", "or": "kBarrierOr"}
REDUCTIONS = {"add": "kReduceAdd", "and": "kReduceAnd", "or": "kReduceOr", "xor": "kReduceXor"}
REDUCTIONS |= {"min": "kReduceMin", "max": "kReduceMax"}


def barrier(instruction: Instruction, scope: Scope) -> str:
    """Translate bar.sync 0; bar.red.popc.u32 d, 0, p; bar.warp.sync mask."""
    modifiers = [m for m in instruction.modifiers if m not in ("cta", "aligned", "pred", "u32")]
    operands = instruction.operands
    if modifiers == ["warp", "sync"]:
        mask = scope.value(instruction, operands[0], "u32")
        return f"go_to_warp(thread, {instruction.line}, Operation::kSyncWarp, {mask});"
    if modifiers == ["sync"] and operands == ("0",):
        return f"go_to_barrier(thread, {instruction.line}, Operation::kBarrier, false, nullptr, nullptr);"
    if modifiers[:1] == ["red"] and modifiers[1] in COUNTS and len(operands) == 3 and operands[1] == "0":
        place, predicate = scope.place_or_null(instruction, operands[0]), scope.value(instruction, operands[2], "pred")
        results = f"{place}, nullptr" if modifiers[1] == "popc" else f"nullptr, {place}"
        return f"go_to_barrier(thread, {instruction.line}, Operation::{COUNTS[modifiers[1]]}, {predicate}, {results});"
    raise instruction.refuse("of barriers, those of the whole block (number 0) and of a warp are known")


def shuffle(instruction: Instruction, scope: Scope) -> str:
    """Translate shfl.sync.down.b32 d|p, a, b, c, mask."""
    sync, mode, kind = instruction.modifiers
    if sync != "sync" or mode not in SHUFFLES or kind != "b32":
        raise instruction.refuse("this shuffle is not known")
    to, *sources = instruction.operands
    value, lane, clamp, mask = (scope.value(instruction, source, "u32") for source in sources)
    place, flag = _places(instruction, scope, to)
    operation = f"Operation::{SHUFFLES[mode]}"
    return f"go_to_shuffle(thread, {instruction.line}, {operation}, {mask}, {value}, {lane}, {clamp}, {place}, {flag});"


def _places(instruction: Instruction, scope: Scope, operand: str) -> tuple[str, str]:
    """Return the addresses of d and p in d|p."""
    place, _, flag = (part.strip() for part in operand.partition("|"))
    return scope.place_or_null(instruction, place), scope.place_or_null(instruction, flag or None)


def vote(instruction: Instruction, scope: Scope) -> str:
    """Translate vote.sync.any.pred p, q, mask; vote.sync.ballot.b32 d, q, mask."""
    if instruction.modifiers[0] != "sync" or instruction.modifiers[1] not in VOTES:
        raise instruction.refuse("this vote is not known")
    to, predicate, mask = instruction.operands
    place = scope.place_or_null(instruction, to)
    results = f"{place}, nullptr" if instruction.modifiers[1] == "ballot" else f"nullptr, {place}"
    value = scope.value(instruction, predicate, "pred")
    mask, operation = scope.value(instruction, mask, "u32"), VOTES[instruction.modifiers[1]]
    return f"go_to_warp(thread, {instruction.line}, Operation::{operation}, {mask}, {value}, {results});"


def match(instruction: Instruction, scope: Scope) -> str:
    """Translate match.any.sync.b32 d, a, mask; match.all.sync.b64 d|p, a, mask."""
    which, _, kind = instruction.modifiers
    to, value, mask = instruction.operands
    place, flag = _places(instruction, scope, to)
    value, mask = scope.value(instruction, value, kind), scope.value(instruction, mask, "u32")
    operation = "kMatchAll" if which == "all" else "kMatchAny"
    return f"go_to_warp(thread, {instruction.line}, Operation::{operation}, {mask}, {value}, {place}, {flag});"


def reduce(instruction: Instruction, scope: Scope) -> str:
    """Translate redux.sync.add.s32 d, a, mask."""
    _, name, kind = instruction.modifiers
    if name not in REDUCTIONS or kind not in ("u32", "s32", "b32"):
        raise instruction.refuse("this reduction is not known")
    operation = REDUCTIONS[name] + ("Signed" if kind == "s32" and name in ("min", "max") else "")
    to, value, mask = instruction.operands
    value, mask = scope.value(instruction, value, "u32"), scope.value(instruction, mask, "u32")
    place = scope.place_or_null(instruction, to)
    return f"go_to_warp(thread, {instruction.line}, Operation::{operation}, {mask}, {value}, {place});"


def elect(instruction: Instruction, scope: Scope) -> str:
    """Translate elect.sync d|p, mask."""
    to, mask = instruction.operands
    place, flag = _places(instruction, scope, to)
    mask = scope.value(instruction, mask, "u32")
    return f"go_to_warp(thread, {instruction.line}, Operation::kElect, {mask}, 0, {place}, {flag});"


HANDLERS: dict[str, MeetingHandler] = {
    "bar": barrier,
    "barrier": barrier,
    "shfl": shuffle,
    "vote": vote,
    "match": match,
    "redux": reduce,
    "elect": elect,
}
