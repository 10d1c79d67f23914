"""When to try again. The only place that decides it: the SDKs' own retries are off."""

from __future__ import annotations

from collections.abc import Callable

from needlehoop.vlm.providers.contract import AskingConfig, ProviderError, Reply


def persist(
    ask: Callable[[], Reply], config: AskingConfig, sleep: Callable[[float], None]
) -> tuple[Reply, tuple[int | str, ...]]:
    """Try until there is a reply, the failure will not pass, or the tries are used up.

    Args:
        ask: one try.
        config: ``tries``, ``first_wait`` and ``longest_wait``.
        sleep: waits so many seconds.

    Returns:
        The reply, and the status of each try.

    Raises:
        ProviderError: the last failure, with the statuses of all tries.
    """
    attempts: tuple[int | str, ...] = ()
    while True:
        try:
            return ask(), (*attempts, config.arrived)
        except ProviderError as error:
            attempts = (*attempts, error.status)
            if error.passing and len(attempts) < config.tries:
                sleep(min(config.longest_wait, config.first_wait * 2 ** (len(attempts) - 1)))
                continue
            tried = f" (tried {len(attempts)} times)" if len(attempts) > 1 else ""
            raise ProviderError(f"{error}{tried}", error.status, attempts) from None
