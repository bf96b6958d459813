# pyright: strict
"""Queries as text, translated to SQL: "subject == 86 and seconds > 10", "'walk' in labels".

    text ─ast.parse─► tree ─translate─► SQL with "?" for every constant, and the constants

The text is parsed as a Python expression and never evaluated. Only what this module lists is allowed: the columns, the
operators of comparison and arithmetic, `and or not in`, constants, and `like(name, "86_*")`.
"""

from __future__ import annotations

import ast
from collections.abc import Collection

from ..errors import BadInput

MAX_CHARACTERS = 4096
COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.Eq: "=",
    ast.NotEq: "<>",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
}
ARITHMETIC: dict[type[ast.operator], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
WORDS = "labels"
"""The column of words between spaces: `"walk" in labels` finds whole words."""

Constant = str | int | float | None


def to_sql(text: str, columns: Collection[str]) -> tuple[str, list[Constant]]:
    """A condition in SQL and its constants. Raises BadInput for anything but a condition on these columns."""
    if len(text) > MAX_CHARACTERS:
        raise BadInput(f"a query has at most {MAX_CHARACTERS:,} characters, not {len(text):,}")
    try:
        tree = ast.parse(text.strip(), mode="eval")
        return _Translation(columns).condition(tree.body)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, BadInput):
            raise
        reason = error.msg if isinstance(error, SyntaxError) else "too many brackets"
        raise BadInput(
            f"the query {text!r:.80} cannot be read ({reason}); write it as: subject == 86 and seconds > 10"
        ) from None


class _Translation:
    """Translates one tree; `constants` collects the values of the "?" from left to right."""

    def __init__(self, columns: Collection[str]) -> None:
        self.columns = columns
        self.constants: list[Constant] = []

    def condition(self, node: ast.expr) -> tuple[str, list[Constant]]:
        return self.of(node), self.constants

    def of(self, node: ast.expr) -> str:
        match node:
            case ast.BoolOp():
                word = " AND " if isinstance(node.op, ast.And) else " OR "
                return f"({word.join(self.of(value) for value in node.values)})"
            case ast.UnaryOp(op=ast.Not()):
                return f"(NOT {self.of(node.operand)})"
            case ast.UnaryOp(op=ast.USub()):
                return f"(- {self.of(node.operand)})"
            case ast.BinOp() if type(node.op) in ARITHMETIC:
                return f"({self.of(node.left)} * 1.0 {ARITHMETIC[type(node.op)]} {self.of(node.right)})"
            case ast.Compare():
                return self.comparison(node)
            case ast.Call(func=ast.Name(id="like"), args=[what, ast.Constant(value=str(pattern))], keywords=[]):
                column = self.of(what)
                self.constants.append(pattern)
                return f"({column} GLOB ?)"
            case ast.Name():
                return self.column(node.id)
            case ast.Constant(value=value) if value is None or isinstance(value, str | int | float):
                return self.constant(value)
            case _:
                raise BadInput(
                    f"a query cannot contain {ast.unparse(node)!r:.60}: it compares columns with values, joined by "
                    'and, or, not, such as: subject == 86 and seconds > 10; like(name, "86_*")'
                )

    def column(self, name: str) -> str:
        if name not in self.columns:
            raise BadInput(
                f"there is no column {name!r:.40} (words of a name need quotes: \"'walk' in labels\"); "
                f"the columns are: {', '.join(self.columns)}"
            )
        return f'"{name}"'

    def constant(self, value: Constant) -> str:
        if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
            raise BadInput(f"the number {value:.3g} is out of range")
        self.constants.append(value)
        return "?"

    def comparison(self, node: ast.Compare) -> str:
        sides = [node.left, *node.comparators]
        parts = [self.pair(*pair) for pair in zip(sides, node.ops, sides[1:], strict=False)]
        return parts[0] if len(parts) == 1 else f"({' AND '.join(parts)})"

    def pair(self, left: ast.expr, operator: ast.cmpop, right: ast.expr) -> str:
        """One comparison. None is compared by IS, as in Python and unlike in SQL."""
        if isinstance(operator, ast.In | ast.NotIn):
            found = self.membership(left, right)
            return found if isinstance(operator, ast.In) else f"(NOT {found})"
        if isinstance(operator, ast.Is | ast.IsNot):
            return f"({self.of(left)} {'IS' if isinstance(operator, ast.Is) else 'IS NOT'} {self.of(right)})"
        if isinstance(operator, ast.Eq | ast.NotEq) and _is_none(left, right):
            return f"({self.of(left)} {'IS' if isinstance(operator, ast.Eq) else 'IS NOT'} {self.of(right)})"
        return f"({self.of(left)} {COMPARISONS[type(operator)]} {self.of(right)})"

    def membership(self, left: ast.expr, right: ast.expr) -> str:
        """`subject in (1, 2)`, `"walk" in labels` (a whole word), `"02" in name` (a part)."""
        if isinstance(right, ast.List | ast.Tuple | ast.Set):
            value = self.of(left)
            return f"({value} IN ({', '.join(self.of(item) for item in right.elts)}))"
        if not (isinstance(right, ast.Name) and isinstance(left, ast.Constant) and isinstance(left.value, str)):
            raise BadInput('write "in" as: subject in (1, 2), "walk" in labels, "02" in name')
        column, text = self.column(right.id), left.value
        self.constants.append(f" {text.lower()} " if right.id == WORDS else text)
        return f"(instr({column}, ?) > 0)"


def _is_none(*nodes: ast.expr) -> bool:
    return any(isinstance(node, ast.Constant) and node.value is None for node in nodes)
