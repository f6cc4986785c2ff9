"""Where a small fault can be put into a module's source, and the source's syntax tree with one of them in it."""

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass

SHOWN_CHARACTERS = 60
SMALL_INTEGER = 16  # up to here a fault is one more or less, above it the double or the half
NUMPY_EXTREMES = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}


@dataclass(frozen=True)
class Place:
    """A node that can be exchanged for a faulty one, with the lines of the statement (or its head) around it."""

    node: ast.AST
    lines: tuple[int, int]
    in_function: bool
    alternatives: tuple[ast.AST, ...]


@dataclass(frozen=True, order=True)
class Fault:
    """One small fault: the alternative `choice` at the place number `place` of the module at `path`."""

    path: str
    place: int
    choice: int
    line: int
    first_line: int
    last_line: int
    in_function: bool
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.old} -> {self.new}"


def faults_in(path: str, source: str) -> list[tuple[Fault, ...]]:
    """For each place of a module that can be faulty, in the order of the source, the faults it can have."""
    return [
        tuple(
            Fault(path, number, choice, place.node.lineno, *place.lines, place.in_function, *shown(place.node, other))
            for choice, other in enumerate(place.alternatives)
        )
        for number, place in enumerate(places(ast.parse(source)))
    ]


def faulty(source: str, place: int, choice: int) -> ast.Module:
    """The syntax tree of a source with one fault in it, numbered as in `faults_in`."""
    tree = ast.parse(source)
    found = list(places(tree))[place]
    _exchange(tree, found.node, found.alternatives[choice])
    return ast.fix_missing_locations(tree)


def shown(old: ast.AST, new: ast.AST) -> tuple[str, str]:
    """Two nodes as a short line of source each; long ones are cut to the surroundings of where they differ."""
    texts = _text(old), _text(new)
    if max(map(len, texts)) <= SHOWN_CHARACTERS:
        return texts
    same = next((k for k, (one, other) in enumerate(zip(*texts, strict=False)) if one != other), 0)
    start = max(0, same - SHOWN_CHARACTERS // 2)
    short_old, short_new = (text[start : start + SHOWN_CHARACTERS] for text in texts)
    return short_old, short_new


def _text(node: ast.AST) -> str:
    return " ".join(ast.unparse(node).split())


def places(tree: ast.Module) -> Iterator[Place]:
    """Every place that can be faulty; docstrings, annotations, decorators, `__all__` and error texts have none."""
    return _in_statements(tree.body, in_function=False)


def _in_statements(statements: list[ast.stmt], *, in_function: bool) -> Iterator[Place]:
    for statement in statements:
        if not _is_left_out(statement):
            yield from _in_statement(statement, in_function=in_function)


def _in_statement(statement: ast.stmt, *, in_function: bool) -> Iterator[Place]:
    inner = in_function or isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef)
    heads = [node for field in _head(statement) for node in _nodes(getattr(statement, field, None))]
    last_line = max((node.end_lineno or 0 for node in heads), default=statement.lineno)
    for node in heads:
        for found, alternatives in (*_in_condition(statement), *_in_expression(node)):
            yield Place(found, (statement.lineno, last_line), in_function, alternatives)
    for field in ("body", "handlers", "cases", "orelse", "finalbody"):
        for part in getattr(statement, field, []):
            if isinstance(part, ast.stmt):
                yield from _in_statements([part], in_function=inner)
            else:  # an `except` or a `case`
                yield from _in_statements(part.body, in_function=inner)


def _head(statement: ast.stmt) -> tuple[str, ...]:
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef):
        return ("args",)
    if isinstance(statement, ast.ClassDef):
        return ("keywords",)
    return tuple(field for field in statement._fields if field not in {"annotation", "body", "orelse", "finalbody"})


def _nodes(value: object) -> list[ast.AST]:
    if isinstance(value, ast.arguments):  # of a function's head only the defaults, which stand for no annotation
        return [default for default in (*value.defaults, *value.kw_defaults) if default is not None]
    values = value if isinstance(value, list) else [value]
    inner = [item.context_expr if isinstance(item, ast.withitem) else item for item in values]
    return [node for node in inner if isinstance(node, ast.expr | ast.keyword)]


def _is_left_out(statement: ast.stmt) -> bool:
    """Whether nothing can be wrong here that a user would meet: error texts, checks on ourselves, type aliases."""
    if isinstance(statement, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom | ast.Global | ast.Nonlocal):
        return True
    if isinstance(statement, ast.If):
        return _text(statement.test) in {"TYPE_CHECKING", "typing.TYPE_CHECKING", "__name__ == '__main__'"}
    if isinstance(statement, ast.Assign):
        return any(isinstance(target, ast.Name) and target.id.startswith("__") for target in statement.targets) or (
            isinstance(statement.value, ast.BinOp) and isinstance(statement.value.op, ast.BitOr)
        )
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _in_expression(node: ast.AST) -> Iterator[tuple[ast.AST, tuple[ast.AST, ...]]]:
    if alternatives := _alternatives(node):
        yield node, alternatives
    yield from _in_condition(node)
    for child in _children(node):
        yield from _in_expression(child)


def _in_condition(node: ast.AST) -> Iterator[tuple[ast.AST, tuple[ast.AST, ...]]]:
    """The condition of an `if`, a `while` or a comprehension, where it is a plain value."""
    for condition in (getattr(node, "test", None), *getattr(node, "ifs", ())):
        if isinstance(condition, ast.Name | ast.Attribute | ast.Call):
            yield condition, (ast.UnaryOp(ast.Not(), condition),)


def _children(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.Subscript) and _text(node.value).endswith("Literal"):
        return
    if isinstance(node, ast.FormattedValue):
        yield node.value  # without its format
        return
    for child in ast.iter_child_nodes(node):
        if isinstance(node, ast.Call) and isinstance(child, ast.keyword) and child.arg == "strict":
            continue  # `zip(strict=True)` is an assertion
        if isinstance(node, ast.Lambda) and isinstance(child, ast.arguments):
            yield from _nodes(child)
            continue
        yield child


def _alternatives(node: ast.AST) -> tuple[ast.AST, ...]:
    for kind, alternatives in _ALTERNATIVES.items():
        if isinstance(node, kind):
            return alternatives(node)
    return ()


def _of_comparison(node: ast.Compare) -> tuple[ast.AST, ...]:
    return tuple(
        ast.Compare(node.left, [*node.ops[:index], other(), *node.ops[index + 1 :]], node.comparators)
        for index, operator in enumerate(node.ops)
        for other in COMPARISONS[type(operator)]
    )


def _of_arithmetic(node: ast.BinOp) -> tuple[ast.AST, ...]:
    other = ARITHMETIC.get(type(node.op))
    return (ast.BinOp(node.left, other(), node.right),) if other is not None and not _is_text(node) else ()


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(side, ast.JoinedStr) or (isinstance(side, ast.Constant) and isinstance(side.value, str | bytes))
        for side in (node.left, node.right)
    )


def _of_sign(node: ast.UnaryOp) -> tuple[ast.AST, ...]:
    return (node.operand,) if isinstance(node.op, ast.USub | ast.Not) else ()


def _of_condition(node: ast.BoolOp) -> tuple[ast.AST, ...]:
    return (ast.BoolOp(ast.Or() if isinstance(node.op, ast.And) else ast.And(), node.values),)


def _of_number(node: ast.Constant) -> tuple[ast.AST, ...]:
    value = node.value
    if isinstance(value, bool):
        return (ast.Constant(not value),)
    if isinstance(value, int):
        small = abs(value) <= SMALL_INTEGER
        return tuple(map(ast.Constant, (value + 1, value - 1) if small else (value * 2, value // 2)))
    if isinstance(value, float):
        return tuple(map(ast.Constant, (value * 2, value / 2) if value else (1.0,)))
    return ()


def _of_call(node: ast.Call) -> tuple[ast.AST, ...]:
    function = node.func
    if isinstance(function, ast.Name) and function.id in NUMPY_EXTREMES:
        return (ast.Call(ast.Name(NUMPY_EXTREMES[function.id], ast.Load()), node.args, node.keywords),)
    if isinstance(function, ast.Attribute) and function.attr in NUMPY_EXTREMES:
        other = ast.Attribute(function.value, NUMPY_EXTREMES[function.attr], ast.Load())
        return (ast.Call(other, node.args, node.keywords),)
    return ()


_ALTERNATIVES: dict[type[ast.AST], Callable[..., tuple[ast.AST, ...]]] = {
    ast.Compare: _of_comparison,
    ast.BinOp: _of_arithmetic,
    ast.UnaryOp: _of_sign,
    ast.BoolOp: _of_condition,
    ast.Constant: _of_number,
    ast.Call: _of_call,
}


def _exchange(tree: ast.AST, old: ast.AST, new: ast.AST) -> None:
    """Puts `new` where `old` stands; `new` may hold `old`, as in `not old`."""
    for parent in list(ast.walk(tree)):
        for field, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, field, new)
                return
            if isinstance(value, list) and any(item is old for item in value):
                setattr(parent, field, [new if item is old else item for item in value])
                return
