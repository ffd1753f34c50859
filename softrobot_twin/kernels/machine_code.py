"""When machine code is made: of what Python calls, and not of its parts.

numba makes machine code of each kernel that it compiles. But what a kernel calls is a part of its
own code, and most of it is never run by itself: of 200 kernels of a scene, Python calls 80. Here a
kernel that others call waits as code of LLVM, of which only each function is simplified. When Python
calls a kernel, it is optimized as a whole, with all its parts.
"""

from __future__ import annotations

from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.environment import lookup_environment

_PACKAGE = __name__.split(".")[0]
# How numba begins the names of what Python calls in this package.
_CALLED_BY_PYTHON = f"_ZN7cpython{len(_PACKAGE)}{_PACKAGE}"


class Library(JITCodeLibrary):
    """Code that becomes machine code when Python first calls it.

    Attributes:
        is_machine_code: Whether it did.
        is_unsaved: Whether the machine code is not yet on disk.
    """

    is_machine_code = is_unsaved = False

    def _optimize_final_module(self) -> None:
        """Waits for `_make_machine_code`."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def _has(self, name: str) -> bool:
        try:
            return not self._final_module.get_function(name).is_declaration
        except NameError:
            return False

    def _make_machine_code(self) -> None:
        self.is_unsaved = True
        # Only what is kept in memory can be written to the disk.
        self._object_caching_enabled, self._compiled_object, self._compiled = True, None, False
        super()._optimize_final_module()
        environments = [each.name for each in self._final_module.global_variables]
        super()._finalize_final_module()
        self._codegen.set_environments(environments)

    def get_pointer_to_function(self, name: str) -> int:
        """Address of a function; 0 where there is none of this name, or only kernels call it yet.

        Args:
            name: The function's.
        """
        self._ensure_finalized()
        waits = self._codegen.is_for_kernels and name.startswith(_CALLED_BY_PYTHON)
        if waits or not self._has(name):
            return 0
        if not self.is_machine_code:
            self.is_machine_code = True
            self._make_machine_code()
        return super().get_pointer_to_function(name)

    def serialize_using_object_code(self) -> tuple:
        """What is kept on disk."""
        self.is_unsaved = False
        if self.is_machine_code:
            return super().serialize_using_object_code()
        return self.serialize_using_bitcode()


class Codegen(JITCPUCodegen):
    """numba's, with the library above.

    Attributes:
        is_for_kernels: Whether what is compiled now is called by a kernel.
    """

    _library_class = Library
    is_for_kernels = False

    def set_env(self, env_name: str, env: object) -> None:
        """Tells machine code where its objects of Python are.

        Args:
            env_name: The name of the place.
            env: The objects.
        """
        # What is no machine code yet has no place; see `set_environments`.
        engine = self._engine
        if engine.is_symbol_defined(env_name) and engine.get_global_value_address(env_name):
            super().set_env(env_name, env)

    def set_environments(self, names: list[str]) -> None:
        """Tells new machine code where the objects of Python are of all kernels in it.

        Args:
            names: Among them those of the places.
        """
        for name in names:
            environment = lookup_environment(name)
            if environment is not None:
                self.set_env(name, environment)
