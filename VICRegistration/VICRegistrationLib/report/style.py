"""How the page looks on screens and on paper."""

CSS = """
:root { color-scheme: light; }
body { margin: 0 auto; padding: 1.5rem 1.5rem 3rem; max-width: 62rem; background: #fff; color: #20242b;
  font: 1rem/1.45 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, "DejaVu Sans", sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .4rem; }
h2 { font-size: 1.4rem; line-height: 1.2; margin: 2.6rem 0 .8rem; padding-bottom: .25rem;
  border-bottom: 2px solid #20242b; }
h3 { font-size: 1.08rem; margin: 1.7rem 0 .5rem; }
h1, h2, th, td, code { unicode-bidi: isolate; }
h1, h2, h2 + p, a, code, li, figcaption { overflow-wrap: anywhere; }
p { margin: .4rem 0; max-width: 46rem; }
a { color: #1a4f9c; }
.about { color: #4a515d; margin: 0; }
.use { display: inline-block; margin: .7rem 0 0; padding: .25rem .7rem; border: 1.5px solid #20242b; font-weight: 600; }
.table { overflow-x: auto; }
.table + .table { margin-top: .5rem; }
table { border-collapse: collapse; font-size: .93rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: #4a515d; padding-bottom: .3rem; }
th, td { padding: .28rem 1.3rem .28rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid #dde1e7; }
thead th { border-bottom: 1.5px solid #6b7380; vertical-align: bottom; }
tbody th { font-weight: 500; color: #333a45; }
tbody th { min-width: 8.5rem; }
td.number { white-space: nowrap; }
code { font: .92em ui-monospace, Menlo, Consolas, "DejaVu Sans Mono", monospace; }
ul { margin: .4rem 0; padding-left: 1.3rem; }
figure { margin: .6rem 0 .8rem; }
img { display: block; max-width: 100%; height: auto; }
figcaption { color: #4a515d; font-size: .9rem; margin-top: .3rem; max-width: 52rem; }
.warnings { margin: 1rem 0; padding: .7rem 1rem; border: 2px solid #a3121a; border-left-width: .6rem; }
.warnings h3 { margin: 0 0 .3rem; color: #a3121a; }
.warnings ul { margin: 0; }
footer { margin-top: 3rem; padding-top: .6rem; border-top: 1px solid #6b7380; color: #4a515d; font-size: .88rem; }
@page { margin: 14mm 13mm 15mm; }
@media print {
  html { font-size: 9.5pt; }
  body { max-width: none; padding: 0; }
  h2 { margin-top: 1.2rem; }
  .organ { break-before: page; }
  .organ h2 { margin-top: 0; }
  h2, h3, caption, thead { break-after: avoid; }
  figure, .table, li, .warnings, .together { break-inside: avoid; }
  img { max-height: 225mm; object-fit: contain; object-position: left; }
  .overview img { max-height: 100mm; }
  .table { overflow: visible; }
  a { color: inherit; text-decoration: none; }
}
"""
