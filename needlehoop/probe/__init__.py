"""The probe: ranks cameras by what an encoder can read off their images, without a policy."""
