"""The pages of finished runs: of one (`run_page`), and of several beside each other (`comparison`)."""
