"""What the providers that use a company's own package (SDK) have in common."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any

from needlehoop.vlm.messages import Request
from needlehoop.vlm.providers.contract import LiveConfig, ProviderError, Reply, failure
from needlehoop.vlm.providers.wire import ReplyError, careful


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
        self._http: Any = None

    def ask(self, request: Request) -> Reply:
        """See ``Provider``."""
        if self._client is None:
            self._http = careful(self._http_client(), self._config.timeout)
            self._client = self._connect(self._http)
        came: list[Reply | Exception] = []
        # On a thread, to bound the whole try: a server that sends a byte now and then never
        # exceeds the limit of a single wait.
        thread = threading.Thread(target=self._try, args=(request, came), daemon=True)
        thread.start()
        thread.join(self._config.timeout)
        if not came:
            # The thread goes on with the old client and ends by itself.
            self._client = None
            raise self._failure("timeout", "")
        if isinstance(came[0], Reply):
            return came[0]
        status = self._status_of(came[0])
        if status is None:
            raise came[0]
        # Not chained: the SDK's own error may repeat the key.
        raise self._failure(*status) from None

    def close(self) -> None:
        """See ``Provider``."""
        if self._client is not None:
            self._client.close()
            self._http.close()

    def _try(self, request: Request, came: list[Reply | Exception]) -> None:
        try:
            came.append(self._send(request))
        except Exception as error:
            came.append(error)

    def _status_of(self, error: Exception) -> tuple[int | str, str] | None:
        """As ``_status``. The SDK may have wrapped our own error in one of its own."""
        for one in _causes(error):
            if isinstance(one, ReplyError):
                return "unreadable", str(one)
            if isinstance(one, TimeoutError):
                return "timeout", ""
        return self._status(error)

    @abstractmethod
    def _http_client(self) -> type[Any]:
        """The class of HTTP clients that the SDK takes."""

    @abstractmethod
    def _connect(self, http: Any) -> Any:
        """The SDK's client, on ``http``, with its retries off: ``Recorder`` decides on them."""

    @abstractmethod
    def _send(self, request: Request) -> Reply:
        """One try with ``_client``. It raises the SDK's errors or ``ProviderError``."""

    @abstractmethod
    def _status(self, error: Exception) -> tuple[int | str, str] | None:
        """An error's status as in ``ProviderError``, and its message.

        ``None`` if the error is no failure to communicate.
        """

    def _failure(self, status: int | str, said: str) -> ProviderError:
        text = f"no answer within {self._config.timeout:g} s" if status == "timeout" else said
        return failure(self._config, self._key, status, text)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """An error and its causes."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
