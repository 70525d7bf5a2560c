"""The tables of parsers: the function for each type of expression and statement in Python's syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from typing import Final

from rhi.shading.parser import calls, expressions, statements
from rhi.shading.parser.context import ExpressionParser, Parsers, StatementParser

_EXPRESSIONS: Final[Mapping[type[ast.expr], ExpressionParser]] = {
    ast.Constant: expressions.parse_constant,
    ast.Name: expressions.parse_name,
    ast.UnaryOp: expressions.parse_unary,
    ast.BinOp: expressions.parse_binary,
    ast.BoolOp: expressions.parse_condition,
    ast.Compare: expressions.parse_comparison,
    ast.IfExp: expressions.parse_selection,
    ast.Attribute: expressions.parse_attribute,
    ast.Subscript: expressions.parse_subscript,
    ast.Call: calls.parse_call,
}
_STATEMENTS: Final[Mapping[type[ast.stmt], StatementParser]] = {
    ast.Pass: statements.parse_pass,
    ast.Expr: statements.parse_expr,
    ast.Assign: statements.parse_assignment,
    ast.AnnAssign: statements.parse_annotated,
    ast.AugAssign: statements.parse_augmented,
    ast.If: statements.parse_if,
    ast.While: statements.parse_while,
    ast.For: statements.parse_for,
    ast.Break: statements.parse_break,
    ast.Continue: statements.parse_continue,
    ast.Return: statements.parse_return,
}

PARSERS: Final = Parsers(_EXPRESSIONS, _STATEMENTS)
"""The parsers of all nodes that the shading language has."""
