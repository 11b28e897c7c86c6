"""What every small web server here needs: files of a page, safe headers, whose request it is."""
