"""What people look at: pages with figures, and the progress of a solve in the terminal.

The only package that knows matplotlib and Jinja. Import the modules one needs: `page` (report of a
solve), `stiffness_page` (report of a robot's joints), `progress` (terminal, without matplotlib).
"""
