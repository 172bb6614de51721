"""Read PTX, the assembly that NVRTC makes of a kernel, into kernels and their statements."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

from mgsr.errors import MgsrError

BYTES = {f"{kind}{bits}": bits // 8 for kind in "bsu" for bits in (8, 16, 32, 64)}
BYTES |= {"f32": 4, "f64": 8, "f32x2": 8}


class PtxError(MgsrError):
    """PTX holds what the machine of the tests doesn't execute; the message names the line and its text."""


@dataclass(frozen=True)
class Instruction:
    """A statement such as `@%p1 add.f32 %f1, %f2, 0f3F800000;`. modifiers: all after the first dot, types too."""

    line: int
    text: str
    predicate: str | None
    negated: bool
    opcode: str
    modifiers: tuple[str, ...]
    operands: tuple[str, ...]

    def refuse(self, why: str) -> PtxError:
        """Return the error to raise for what is not executed."""
        return PtxError(f"PTX line {self.line}, `{self.text}`: {why}; tests/ptx_machine does not execute it")


@dataclass(frozen=True)
class Label:
    name: str


@dataclass(frozen=True)
class BranchTargets:
    """The labels that `brx.idx` chooses from."""

    name: str
    labels: tuple[str, ...]


Statement = Instruction | Label | BranchTargets


@dataclass(frozen=True)
class Registers:
    """A declaration `.reg .kind %name;`, or with a count `.reg .kind %name<count>;`."""

    kind: str
    count: int | None


@dataclass(frozen=True)
class Variable:
    """Memory with a name. data: what it holds at first, for variables of the module."""

    space: str
    alignment: int
    size: int
    data: bytes = b""


@dataclass
class Kernel:
    name: str
    parameter: str
    parameter_bytes: int
    most_threads: int
    registers: dict[str, Registers] = field(default_factory=dict)
    variables: dict[str, Variable] = field(default_factory=dict)
    statements: list[Statement] = field(default_factory=list)


@dataclass(frozen=True)
class Module:
    kernels: list[Kernel]
    variables: dict[str, Variable]


@dataclass(frozen=True)
class Places:
    """Where a line of PTX comes from, for messages: from `.loc` directives, which --generate-line-info adds."""

    lines: list[str]
    sources: dict[int, str]

    @classmethod
    def of(cls, text: str) -> Places:
        files = {int(number): name for number, name in re.findall(r'^\s*\.file\s+(\d+)\s+"([^"]*)"', text, re.M)}
        lines, sources, source = text.splitlines(), dict[int, str](), ""
        for number, line in enumerate(lines, 1):
            if match := re.match(r"\s*\.loc\s+(\d+)\s+(\d+)", line):
                source = f"{files.get(int(match[1]), '?')}:{match[2]}"
            sources[number] = source
        return cls(lines, sources)

    def describe(self, line: int) -> str:
        source = self.sources.get(line)
        text = " ".join(self.lines[line - 1].split())
        return f"PTX line {line} `{text}`" + (f" of {source}" if source else "")


def parse(text: str) -> Module:
    """Return the module's kernels and variables.

    Raises PtxError for what it can't read.
    """
    code = _without_comments(text)
    variables = dict(_variables(_outside_of_braces(code)))
    kernels = [_kernel(code, match) for match in re.finditer(r"\.visible\s+\.entry\s+([\w$]+)\s*\(", code)]
    return Module(kernels, variables)


def _without_comments(text: str) -> str:
    """Return the code with comments, and the lines of directives that no `;` ends, blanked.

    Each character stays in its line.
    """

    def blank(match: re.Match[str]) -> str:
        return re.sub(r"[^\n]", " ", match[0])

    text = re.sub(r"/\*.*?\*/", blank, text, flags=re.S)
    return re.sub(r"//[^\n]*|^[ \t]*\.(?:loc|file|version|target|address_size)\b[^\n]*", blank, text, flags=re.M)


def _outside_of_braces(code: str) -> str:
    """Return the module's own declarations. Braces of initialisers stay; those of functions and sections go."""
    kept, depth, body = [], 0, 0
    for position, character in enumerate(code):
        if character == "{":
            depth += 1
            if depth == 1 and not re.search(r"=\s*$", code[max(0, position - 20) : position]):
                body = depth
        if not body:
            kept.append(character)
        if character == "}":
            depth -= 1
            body = 0 if depth == 0 else body
    return "".join(kept)


DECLARATION = re.compile(
    r"\.(?P<space>global|const|shared|local)\s+(?:\.attribute\S*\s+)?(?:\.align\s+(?P<align>\d+)\s+)?"
    r"\.(?P<type>[bsuf]\d+)\s+(?P<name>[\w$]+)\s*(?:\[\s*(?P<count>\d+)\s*\])?\s*(?:=\s*(?P<values>[^;]*))?;"
)


def _variables(code: str) -> Iterator[tuple[str, Variable]]:
    for match in DECLARATION.finditer(code):
        size = BYTES[match["type"]] * int(match["count"] or 1)
        data = _initial_bytes(match["values"], match["type"], match["name"]) if match["values"] else b""
        alignment = int(match["align"] or BYTES[match["type"]])
        yield match["name"], Variable(match["space"], alignment, size, data.ljust(size, b"\0"))


def _initial_bytes(values: str, kind: str, name: str) -> bytes:
    """Return what `{1, 2, 3}` or a single number holds, as little-endian bytes."""
    numbers = [value.strip() for value in values.strip().strip("{}").split(",") if value.strip()]
    try:
        return b"".join(_number(n).to_bytes(16, "little", signed=True)[: BYTES[kind]] for n in numbers)
    except ValueError as error:
        raise PtxError(f"the initial value of {name} is not made of numbers ({error})") from error


def _number(text: str) -> int:
    """Return an integer, or the bits of a float's literal such as 0f3F800000."""
    return int(text[2:], 16) if text[:2] in ("0f", "0F", "0d", "0D") else int(text.rstrip("U"), 0)


def _kernel(code: str, match: re.Match[str]) -> Kernel:
    head_end = code.index("{", match.end())
    head = code[match.end() : head_end]
    parameters = re.findall(r"\.param\s+(?:\.align\s+\d+\s+)?\.b8\s+([\w$]+)\[(\d+)\]", head)
    if len(parameters) != 1 or head.count(".param") != 1:
        raise PtxError(f"kernel {match[1]}: expected one struct as parameter, got `{' '.join(head.split())}`")
    (parameter, size), most = parameters[0], re.search(r"\.maxntid\s+(\d+)", head)
    kernel = Kernel(match[1], parameter, int(size), int(most[1]) if most else 1024)
    _Body(kernel, code, head_end).read()
    return kernel


class _Body:
    """Reads a kernel's statements. Registers that an inner block declares get names of their own."""

    def __init__(self, kernel: Kernel, code: str, start: int) -> None:
        self._kernel, self._code, self._at = kernel, code, start
        self._line = code.count("\n", 0, start) + 1
        self._renamed: list[dict[str, str]] = []

    def read(self) -> None:
        while True:
            character = self._skip_blanks()
            if character == "{":
                self._renamed.append({})
                self._at += 1
            elif character == "}":
                self._renamed.pop()
                self._at += 1
                if not self._renamed:
                    return
            else:
                self._read_statement()

    def _skip_blanks(self) -> str:
        while self._code[self._at].isspace():
            self._line += self._code[self._at] == "\n"
            self._at += 1
        return self._code[self._at]

    def _read_statement(self) -> None:
        line = self._line
        if label := re.compile(r"([\w$]+)\s*:").match(self._code, self._at):
            self._at = label.end()
            if targets := re.compile(r"\s*\.branchtargets([^;]*);").match(self._code, self._at):
                self._take(targets.end())
                self._kernel.statements.append(BranchTargets(label[1], tuple(split_operands(targets[1]))))
            else:
                self._kernel.statements.append(Label(label[1]))
            return
        text = " ".join(self._take(self._code.index(";", self._at) + 1).split())
        if text.startswith("."):
            self._declare(text, line)
        else:
            self._kernel.statements.append(_instruction(self._with_own_names(text), line))

    def _take(self, end: int) -> str:
        text = self._code[self._at : end]
        self._line += text.count("\n")
        self._at = end
        return text

    def _declare(self, text: str, line: int) -> None:
        if match := re.match(r"\.reg\s+\.(\w+)\s+(.*);", text):
            for name in split_operands(match[2]):
                self._declare_register(match[1], name)
        elif DECLARATION.match(text):
            self._kernel.variables.update(_variables(text))
        elif not text.startswith(".pragma"):
            raise PtxError(f"PTX line {line}, `{text}`: an unknown directive; tests/ptx_machine does not read it")

    def _declare_register(self, kind: str, name: str) -> None:
        match = re.fullmatch(r"([%\w$]+)(?:<(\d+)>)?", name)
        assert match, name
        own = match[1]
        if len(self._renamed) > 1:
            own = self._renamed[-1][match[1]] = f"{match[1]}_of_block{len(self._kernel.registers)}"
        self._kernel.registers[own] = Registers(kind, int(match[2]) if match[2] else None)

    def _with_own_names(self, text: str) -> str:
        for names in self._renamed:
            if names:
                text = re.sub(r"%?[A-Za-z_$][\w$]*", partial(_own_name, names), text)
        return text


def _instruction(text: str, line: int) -> Instruction:
    match = re.match(r"(?:@(!?)([%\w$]+)\s+)?([\w.:]+)\s*(.*);$", text)
    if not match:
        raise PtxError(f"PTX line {line}, `{text}`: not an instruction that tests/ptx_machine can read")
    opcode, *modifiers = match[3].replace("::", "@").split(".")
    modifiers = [modifier.replace("@", "::") for modifier in modifiers]
    return Instruction(line, text, match[2], match[1] == "!", opcode, tuple(modifiers), tuple(split_operands(match[4])))


def split_operands(text: str) -> list[str]:
    """Split at commas; vectors {a, b} and addresses [a] stay whole."""
    parts = re.findall(r"(?:\{[^}]*\}|\[[^\]]*\]|[^,{\[])+", text)
    return [part.strip() for part in parts if part.strip()]


def _own_name(names: dict[str, str], match: re.Match[str]) -> str:
    return names.get(match[0], match[0])
