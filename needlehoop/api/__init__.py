"""What the calls of ``import needlehoop`` do: environments and policies, from names or runs."""
