"""What providers that go through a company's own package have in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from needlehoop.vlm.messages import Request
from needlehoop.vlm.providers.contract import LiveConfig, ProviderError, Reply, failure


class SdkProvider(ABC):
    """A provider whose client is made at the first request.

    Args:
        config: whom to ask and how.

    Raises:
        ValueError: no key.
    """

    def __init__(self, config: LiveConfig):
        self._config = config
        self._key = config.read_key()
        self._client: Any = None

    def ask(self, request: Request) -> Reply:
        """See ``Provider``."""
        if self._client is None:
            self._client = self._connect()
        try:
            return self._send(request)
        except Exception as error:
            status = self._status(error)
            if status is None:
                raise
            # The SDK's own error may carry what the server said of the key.
            raise self._failure(*status) from None

    def close(self) -> None:
        """See ``Provider``."""
        if self._client is not None:
            self._client.close()

    @abstractmethod
    def _connect(self) -> Any:
        """The client, with its own retries off: the policy is in ``retries`` alone."""

    @abstractmethod
    def _send(self, request: Request) -> Reply:
        """One try with ``_client``; errors are the SDK's, or ``ProviderError``."""

    @abstractmethod
    def _status(self, error: Exception) -> tuple[int | str, str] | None:
        """An error's status as in ``ProviderError``, and what it says.

        ``None`` for what is no failure to communicate.
        """

    def _failure(self, status: int | str, said: str) -> ProviderError:
        text = f"no answer within {self._config.timeout:g} s" if status == "timeout" else said
        return failure(self._config, self._key, status, text)
