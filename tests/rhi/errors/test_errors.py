"""Errors name the rule, the call, what was given, and the user's line."""

import pickle
import re
import sys

import pytest

from rhi.errors import RULES, DeviceError, Rule, ShaderError, ValidationError, refuse
from rhi.errors.call_sites import MARK, CallSite, find_user_frame


@pytest.fixture
def rule():
    created = Rule("test-rule", "the rule's sentence", "the rule's tip")
    yield created
    del RULES[created.id]


def internal(source):
    """Functions as if they were part of the package."""
    scope = {MARK: True, "refuse": refuse, "find_user_frame": find_user_frame}
    exec(source, scope)
    return scope


def test_a_rule_is_found_by_its_id(rule):
    assert RULES["test-rule"] is rule


def test_an_id_can_be_used_only_once(rule):
    with pytest.raises(ValueError, match="already taken"):
        Rule("test-rule", "another")
    assert RULES["test-rule"] is rule


def test_ids_are_short_words_and_sentences_have_no_full_stop():
    import renderer.rules  # noqa: F401
    import rhi.errors.rules  # noqa: F401

    assert len(RULES) > 20
    for rule in RULES.values():
        assert re.fullmatch(r"[a-z]+(-[a-z]+)+", rule.id)
        assert rule.sentence
        assert not rule.sentence.endswith(".")


def test_a_refusal_names_everything(rule):
    with pytest.raises(ValidationError) as caught:
        refuse(rule, "thing.call(x)", 3, "1 or 2")
    error = caught.value
    line = sys._getframe().f_lineno - 2
    assert str(error).splitlines() == [
        "[test-rule] the rule's sentence",
        "  call:    thing.call(x)",
        "  given:   3",
        "  allowed: 1 or 2",
        f"  at:      {__file__}:{line}",
        "  tip:     the rule's tip",
    ]
    assert (error.rule, error.call, error.given, error.allowed) == (rule, "thing.call(x)", "3", "1 or 2")


def test_an_error_omits_the_parts_that_it_lacks(rule):
    with pytest.raises(ValidationError) as caught:
        refuse(rule, "thing.call(x)", tip="another tip")
    assert "given" not in str(caught.value)
    assert "allowed" not in str(caught.value)
    assert "another tip" in str(caught.value)


def test_text_of_several_lines_is_kept_aligned(rule):
    error = ValidationError(rule, "call", "one\ntwo")
    assert "  given:   one\n           two\n" in str(error)


def test_the_line_is_the_users_however_deep_the_package_was(rule):
    scope = internal("def outer(rule): inner(rule)\ndef inner(rule): refuse(rule, 'call')\n")
    with pytest.raises(ValidationError) as caught:
        scope["outer"](rule)
    assert caught.value.site == CallSite(__file__, sys._getframe().f_lineno - 1)
    assert caught.value.site.function == "test_the_line_is_the_users_however_deep_the_package_was"


def test_the_innermost_user_frame_counts_when_the_package_calls_back(rule):
    scope = internal("def call(function): function()\n")

    def callback():
        refuse(rule, "call")

    with pytest.raises(ValidationError) as caught:
        scope["call"](callback)
    assert caught.value.site.function.endswith("callback")


def test_a_stack_without_a_user_frame_has_no_line():
    frame = sys._getframe()
    above = 0
    while frame is not None:
        frame, above = frame.f_back, above + 1
    with pytest.raises(ValueError, match="not deep enough"):
        find_user_frame(above + 5)
    assert find_user_frame(1) is sys._getframe()


@pytest.mark.parametrize(
    ("error", "base"), [(ValidationError, ValueError), (ShaderError, TypeError), (DeviceError, RuntimeError)]
)
def test_an_error_is_also_the_python_error_that_one_would_catch(error, base, rule):
    with pytest.raises(base):
        raise error(rule, "call")


def test_a_pickled_error_keeps_its_type_and_fields(rule):
    with pytest.raises(ValidationError) as caught:
        refuse(rule, "f(x)", 3, "4", "count again")
    error = caught.value
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is ValidationError
    assert again.rule.id == error.rule.id
    assert (again.call, again.given, again.allowed, again.tip) == ("f(x)", "3", "4", "count again")
    assert again.site == error.site
    assert str(again) == str(error)
