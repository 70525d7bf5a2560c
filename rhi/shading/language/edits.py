"""Edits of shader modules while a program runs: a new text takes effect in the existing classes.

- The text is executed as a module beside the old one. If that fails, nothing has changed.
- Its definitions are then copied **into the existing classes and functions**: methods, constants, bindings
  and bases of a shader class, the body of a `@function`, the fields of a struct. Modules that imported a
  class, classes derived from it and programs made from it see the change, and types stay identical.
- Constants and imports at the top level change in this module only: a number that another module imported
  stays. Plain Python functions and classes stay, since their objects and callbacks are in use, with the
  imports that they use.
- A struct can't change once buffers or meshes use it, because their memory has the old layout.
- A text that lacks all definitions, or a class that something uses, is refused: it was cut off, or saved
  empty. Definitions that nothing uses may go. They are remembered, and are the same objects when they come
  back.
- `Edit.undo` restores everything, for an edit that doesn't compile.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from importlib.machinery import ModuleSpec
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, Final, NoReturn, TypeAlias, TypeVar, cast, get_args, get_origin
from weakref import WeakKeyDictionary

from rhi.contract.layout import ArrayType, HostType, StructType
from rhi.errors import ShaderError
from rhi.errors.call_sites import CallSite, find_call_site
from rhi.shading.language import rules
from rhi.shading.language.function import ShadingFunction
from rhi.shading.language.modules import execute, is_own
from rhi.shading.language.shader import Shader, SharedMemory, collect_bindings
from rhi.shading.language.source import (
    SourceFile,
    exchange_source,
    forget_signatures,
    pin_source,
    read_file,
    set_source,
)
from rhi.shading.language.structs import Struct
from rhi.shading.language.types import StorageType

_UNEDITED: Final = frozenset(
    (
        "__dict__",
        "__weakref__",
        "__module__",
        "__qualname__",
        "__firstlineno__",
        "__static_attributes__",
        "_declared",
    )
)
"""Attributes of a class that aren't part of its text, or are derived from the others."""

_Definition: TypeAlias = "type[Shader] | type[Struct] | ShadingFunction[..., Any]"

_removed: Final[WeakKeyDictionary[ModuleType, dict[tuple[str, str], Any]]] = WeakKeyDictionary()
"""Definitions that the text of a module has lost, by their name and kind."""

Undo = Callable[[], object]
C = TypeVar("C")


class Edit:
    """A new text of a module that has taken effect.

    Attributes:
        module: the module.
        file: the name of its file.
        classes: the shader classes of the module.
        structs: the earlier types of changed structs.
    """

    def __init__(
        self, module: ModuleType, text: str, is_used: Callable[[type[Shader]], bool] = lambda _: False
    ) -> None:
        """Execute the text and put it into the module.

        Args:
            is_used: whether programs use a shader class. Those of derived classes count, too.

        Raises:
            ShaderError: `shading-text`: the text isn't Python or raises an exception; `shading-reload`: the
                text changes what can't change, or lacks what is in use; or a class of the language refuses
                it. Nothing has changed then.
        """
        self.module = module
        self.file = file_of(module)
        self.classes: list[type[Shader]] = []
        self.structs: set[StructType] = set()
        self._undo: list[Undo] = [self._collect_all]  # at the end, when nothing can fail any more
        self._file = SourceFile(self.file)
        self._file.lines, self._file.spec = text.splitlines(keepends=True), module.__spec__
        self._file.is_pinned = module.__name__ == "__main__"
        try:
            beside = self._execute(text)
            self._exchanges = self._pair(beside)
            self._check_removed(beside, is_used)
            self._put(beside)
        except BaseException:
            self.undo()
            raise

    def undo(self) -> None:
        """Restore the state before the edit."""
        while self._undo:
            self._undo.pop()()

    def _execute(self, text: str) -> ModuleType:
        """Run the text in a new module of the same name, which nothing imports."""
        module, file = self.module, self._file
        beside = ModuleType(module.__name__)
        beside.__spec__ = ModuleSpec(module.__name__, None, loader_state=file)
        for name in ("__file__", "__package__", "__path__"):
            if name in vars(module):
                vars(beside)[name] = vars(module)[name]
        execute(f"reload of {module.__name__}", file, text, beside, module)
        return beside

    # -- what belongs together -----------------------------------------------------------------------------

    def _pair(self, beside: ModuleType) -> dict[int, Any]:
        """Return the existing class or function for each new one, by the id of the new one."""
        existing = {**_removed.get(self.module, {}), **_list_definitions(self.module)}
        new = _list_definitions(beside)
        aliases_first = sorted(new, key=lambda key: key[0] == _name_of(new[key]))
        return {id(new[key]): existing[key] for key in aliases_first if key in existing}

    def _check_removed(self, beside: ModuleType, is_used: Callable[[type[Shader]], bool]) -> None:
        """Refuse a text without a definition that is in use, or without any; remember what else it lacks."""
        before, after = _list_definitions(self.module), _list_definitions(beside)
        paired = {id(value) for value in self._exchanges.values()}
        lost = {key: value for key, value in before.items() if id(value) not in paired}
        if before and not after:
            self._refuse_removal("the text", "no shader, struct or function")
        importers = self._list_importers(lost.values()) if lost else {}
        for (name, _), value in lost.items():
            user = importers.get(id(value), "")
            if not user and isinstance(value, type) and issubclass(value, Shader):
                user = self._describe_shader_use(value, is_used)
            if user:
                self._refuse_removal(name, f"it is gone; {user}")
        remembered = _removed.setdefault(self.module, {})
        self._undo.append(partial(_restore_dict, remembered, dict(remembered)))
        remembered.update(lost)
        for key, value in list(remembered.items()):
            if id(value) in paired:
                del remembered[key]

    def _list_importers(self, values: Iterable[_Definition]) -> dict[int, str]:
        """Return which definitions other modules have imported, by id, with the module."""
        ids = set(map(id, values))
        return {
            id(value): f"{module.__name__} has imported it"
            for module in list(sys.modules.values())
            if isinstance(module, ModuleType) and module is not self.module
            for value in list(vars(module).values())
            if id(value) in ids
        }

    def _describe_shader_use(self, shader: type[Shader], is_used: Callable[[type[Shader]], bool]) -> str:
        if is_used(shader):
            return "programs are made of it"
        for derived in _subclasses(shader):
            if derived.__module__ != self.module.__name__:
                return f"{derived.__module__}.{derived.__qualname__} is derived from it"
            if is_used(derived) and self._is_current(derived):
                return f"programs are made of {derived.__qualname__}, which is derived from it"
        return ""

    def _is_current(self, cls: type) -> bool:
        """True if a class isn't left over from a text that was refused, or that was copied into another."""
        is_nested = "." in cls.__qualname__
        is_elsewhere = cls.__module__ != self.module.__name__
        return is_nested or is_elsewhere or any(value is cls for value in vars(self.module).values())

    def _translate(self, value: Any) -> Any:
        """Return an annotation or constant in which new classes are replaced by the existing ones."""
        if id(value) in self._exchanges:
            return self._exchanges[id(value)]
        origin, arguments = get_origin(value), get_args(value)
        if origin is None or not any(id(argument) in self._exchanges for argument in arguments):
            return value
        return origin[tuple(map(self._translate, arguments))]

    def _adopt(self, function: FunctionType, owner: type | None = None) -> FunctionType:
        """Return a copy of a new function whose globals are those of the existing module."""
        closure = function.__closure__
        if closure is not None and owner is not None:  # the cell of `super()`
            free = function.__code__.co_freevars
            closure = tuple(
                CellType(owner) if name == "__class__" else cell
                for name, cell in zip(free, closure, strict=True)
            )
        adopted = FunctionType(
            function.__code__, vars(self.module), function.__name__, function.__defaults__, closure
        )
        adopted.__kwdefaults__ = function.__kwdefaults__
        adopted.__annotations__ = {
            name: self._translate(annotation) for name, annotation in function.__annotations__.items()
        }
        adopted.__qualname__, adopted.__doc__ = function.__qualname__, function.__doc__
        adopted.__module__ = function.__module__
        vars(adopted).update(vars(function))
        set_source(adopted, self._file)
        return adopted

    # -- putting it in place -------------------------------------------------------------------------------

    def _put(self, beside: ModuleType) -> None:
        module = self.module
        before, after = dict(vars(module)), dict(vars(beside))
        for name, new in after.items():
            if name.startswith("__") and name.endswith("__") and name != "__doc__":
                continue
            old = before.get(name, new)
            if self._is_plain(new) and not isinstance(old, ShadingFunction):
                new = old
            self._set_name(name, self._exchanges.get(id(new), new))
        used_names = _list_names_used(value for value in before.values() if self._is_plain(value))
        for name, old in before.items():
            is_submodule = isinstance(old, ModuleType) and old.__name__ == f"{module.__name__}.{name}"
            stays = self._is_plain(old) or is_submodule or name in used_names or name.startswith("__")
            stays |= module.__name__ == "__main__"  # the running program's variables
            if name not in after and not stays:
                self._set_name(name, None, is_removed=True)
        exchanged = exchange_source(self._file)
        self._undo.append(lambda: exchange_source(exchanged, str(self._file)))
        self._undo.append(forget_signatures)
        forget_signatures()
        structs = [
            (old, new)
            for new in after.values()
            if _is_kind(new, Struct) and (old := self._exchanges.get(id(new))) is not None
        ]
        self._put_structs(structs)
        for new in after.values():
            if not is_own(new, self.module):
                continue
            if isinstance(new, ShadingFunction):
                self._put_function(self._exchanges.get(id(new), new), new)
            elif _is_kind(new, Shader):
                self._put_shader(self._exchanges.get(id(new), new), new)

    def _is_plain(self, value: object) -> bool:
        """True if a value is a function or class of Python that the module defines: these stay."""
        is_python = isinstance(value, FunctionType | type) and not _is_kind(value, (Shader, Struct))
        return is_python and is_own(value, self.module)

    def _set_name(self, name: str, value: object, is_removed: bool = False) -> None:
        names = vars(self.module)
        if name in names:
            self._undo.append(partial(names.__setitem__, name, names[name]))
        elif not is_removed:
            self._undo.append(lambda: names.pop(name, None))
        if is_removed:
            del names[name]
        else:
            names[name] = value

    def _put_function(self, old: ShadingFunction[..., Any], new: ShadingFunction[..., Any]) -> None:
        python, adopted = old.python, self._adopt(new.python)
        self._undo.append(lambda: _set_python(old, python))
        _set_python(old, adopted)

    def _put_shader(self, old: type[Shader], new: type[Shader]) -> None:
        """Copy the members, annotations and bases of the new class into the existing one."""
        before = {name: value for name, value in vars(old).items() if name not in _UNEDITED}
        after = {name: value for name, value in vars(new).items() if name not in _UNEDITED}
        bases, new_bases = old.__bases__, tuple(map(self._translate, new.__bases__))
        self._undo.append(partial(_restore_shader, old, before, bases))
        if bases != new_bases:
            try:
                old.__bases__ = new_bases
            except TypeError as error:
                self._refuse(f"class {old.__name__}", f"other bases: {error}")
        for name in before.keys() - after.keys():
            delattr(old, name)
        for name, value in after.items():
            if isinstance(value, FunctionType):
                value = self._adopt(value, old)
            elif isinstance(value, staticmethod):
                value = staticmethod(self._adopt(cast("FunctionType", value.__func__), old))
            elif name == "__annotations__":
                value = {key: self._translate(annotation) for key, annotation in value.items()}
            else:
                value = self._translate(value)
            setattr(old, name, value)
        self.classes.append(old)
        _recollect_bindings(old, vars(self.module))

    def _collect_all(self) -> None:
        for cls in self.classes:
            _recollect_bindings(cls, vars(self.module))

    def _put_structs(self, pairs: list[tuple[type[Struct], type[Struct]]]) -> None:
        changed = [(old, new) for old, new in pairs if old.shading_type != new.shading_type]
        types = [old.shading_type for old, _ in changed]
        for old, _ in changed:
            user = self._describe_use(old.shading_type, types)
            if user:
                self._refuse(f"struct {old.__name__}", f"other fields; {user}")
        self.structs.update(types)
        for old, new in pairs:
            attributes = ("shading_type", "_roles", "_defaults", "_depth", "_leaves", "__annotations__")
            fields = [field.name for struct in (old, new) for field in struct.shading_type.fields]
            names = dict.fromkeys((*attributes, *fields))
            before = {name: vars(old)[name] for name in names if name in vars(old)}
            self._undo.append(partial(_set_members, old, before, names))
            _set_members(old, {name: vars(new)[name] for name in names if name in vars(new)}, names)

    def _describe_use(self, type: StructType, changed: list[StructType]) -> str:
        """Return a description of the memory that has the layout of a struct, or ""."""
        for shader in filter(self._is_current, _subclasses(Shader)):
            for declaration in shader._declared.values():
                if _contains(declaration.type, type):
                    return f"{shader.__name__}.{declaration.name} is a binding of it"
            vertex = shader.__dict__.get("vertex")
            annotations = getattr(vertex, "__annotations__", {})
            for name, host in annotations.items():
                if name != "return" and _is_kind(host, Struct) and _contains(host.shading_type, type):
                    return f"{shader.__name__}.vertex reads vertices of it"
        for struct in filter(self._is_current, _subclasses(Struct)):
            if struct.shading_type not in changed and _contains(struct.shading_type, type):
                return f"the struct {struct.__name__} contains it"
        return ""

    def _refuse_removal(self, call: str, actual: str) -> NoReturn:
        """Refuse a text because of what it lacks, at its last line: there it may have been cut off."""
        site = CallSite(str(self._file), max(len(self._file.lines), 1))
        tip = (
            "save the complete file again, or restart the program; until then draws use the previous version"
        )
        raise ShaderError(rules.RELOAD, call, actual, tip=tip, site=site)

    def _refuse(self, call: str, actual: str) -> NoReturn:
        site = find_call_site()
        name = call.split()[-1]
        for number, line in enumerate(self._file.lines, 1):
            if line.split("(")[0].split(":")[0].split() == ["class", name]:
                site = CallSite(str(self._file), number)
        raise ShaderError(rules.RELOAD, call, actual, site=site)


def file_of(module: ModuleType) -> str:
    """Return the name of a module's file, or of the module."""
    spec = module.__spec__
    return (spec.origin if spec is not None else None) or getattr(module, "__file__", None) or module.__name__


def text_of(module: ModuleType) -> str:
    """Return the text of a module that is in effect: the imported one, or that of the last edit."""
    return "".join(read_file(file_of(module), vars(module)).lines)


def pin_program(module: ModuleType) -> None:
    """Pin the text of a program, `__main__`: it is the one that runs, and not the one that its file has later."""
    if module.__name__ == "__main__":
        pin_source(file_of(module), vars(module))


def defines_shaders(module: ModuleType) -> bool:
    """Return whether a module itself defines shaders, structs or shading functions."""
    for value in list(vars(module).values()):
        python = value.python if isinstance(value, ShadingFunction) else value
        if (
            python is not value or _is_kind(value, (Shader, Struct))
        ) and python.__module__ == module.__name__:
            return True
    return False


def _list_definitions(module: ModuleType) -> dict[tuple[str, str], Any]:
    """Return the shaders, structs and functions of the language that a module itself defines, by their name
    and kind."""
    definitions: dict[tuple[str, str], Any] = {}
    for name, value in list(vars(module).items()):
        if is_own(value, module):
            for kind in (Shader, Struct):
                if _is_kind(value, kind):
                    definitions[name, kind.__name__] = value
            if isinstance(value, ShadingFunction):
                definitions[name, "function"] = value
    return definitions


def _list_names_used(values: Iterable[object]) -> set[str]:
    """Return the names that functions, and those of classes, look up: globals and attributes."""
    names: set[str] = set()
    waiting: list[object] = list(values)
    while waiting:
        value = waiting.pop()
        if isinstance(value, type):
            waiting += [getattr(member, "__func__", member) for member in vars(value).values()]
        elif isinstance(value, FunctionType):
            waiting.append(value.__code__)
        elif isinstance(value, CodeType):
            names.update(value.co_names)
            waiting += value.co_consts
    return names


def _name_of(value: _Definition) -> str:
    return value.python.__name__ if isinstance(value, ShadingFunction) else value.__name__


def _restore_dict(target: dict[Any, Any], before: dict[Any, Any]) -> None:
    target.clear()
    target.update(before)


def _is_kind(value: object, kind: type | tuple[type, ...]) -> bool:
    return isinstance(value, type) and issubclass(value, kind)


def _set_python(function: ShadingFunction[..., Any], python: FunctionType) -> None:
    function.python = function.__wrapped__ = python
    function.__doc__ = python.__doc__


def _restore_shader(cls: type[Shader], before: Mapping[str, Any], bases: tuple[type, ...]) -> None:
    if cls.__bases__ != bases:
        cls.__bases__ = bases
    for name in [name for name in vars(cls) if name not in _UNEDITED and name not in before]:
        delattr(cls, name)
    for name, value in before.items():
        setattr(cls, name, value)


def _set_members(cls: type, members: Mapping[str, Any], names: Mapping[str, None]) -> None:
    for name in names:
        if name in members:
            setattr(cls, name, members[name])
        elif name in vars(cls):
            delattr(cls, name)


def _subclasses(cls: type[C]) -> Iterator[type[C]]:
    """Yield all classes derived from a class, nearest first."""
    waiting: list[type[C]] = cls.__subclasses__()
    seen: set[type[C]] = set()
    while waiting:
        subclass = waiting.pop(0)
        if subclass not in seen:
            seen.add(subclass)
            yield subclass
            waiting += subclass.__subclasses__()


def _recollect_bindings(cls: type[Shader], names: dict[str, Any]) -> None:
    """Collect the bindings of a class and its subclasses again."""
    collect_bindings(cls, names)
    for derived in sorted(_subclasses(cls), key=lambda subclass: len(subclass.__mro__)):
        own_bindings = {
            name: declared
            for name, declared in derived._declared.items()
            if (declared.table or name) in inspect.get_annotations(derived)
            or isinstance(derived.__dict__.get(name), SharedMemory)
        }
        inherited: dict[str, Any] = {}
        for base in reversed(derived.__mro__[1:]):
            inherited.update(base.__dict__.get("_declared", {}))
        derived._declared = {**inherited, **own_bindings}


def _contains(type: Any, part: HostType) -> bool:
    if type == part:
        return True
    if isinstance(type, StructType):
        return any(_contains(field.type, part) for field in type.fields)
    return isinstance(type, ArrayType | StorageType) and _contains(type.element, part)
