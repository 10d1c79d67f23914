"""The task on an engine, and its faces: TorchRL, dm_control. Nothing learns here."""
