"""Images by rays: the kernel that traces and collects them, stars in passes."""
