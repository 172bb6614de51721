"""The page's style sheet and script."""

CSS = """
:root{color-scheme:light dark;--bg:#fbfaf8;--card:#fff;--tile:#f1efeb;--ink:#22211f;--soft:#66625b;--line:#e3dfd8;
--a:#1f6fb2;--b:#c2571a;--accent:#1f6fb2}
@media (prefers-color-scheme:dark){:root{--bg:#151618;--card:#1c1d20;--tile:#3a3d43;--ink:#ecebe8;--soft:#a3a09a;
--line:#33353a;--a:#6cb4ee;--b:#f0955b;--accent:#6cb4ee}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--bg);color:var(--ink);font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,sans-serif}
main,header,footer{max-width:1180px;margin:0 auto;padding:0 20px}
header{padding-top:44px}
h1{font-size:clamp(1.7rem,5vw,2.5rem);line-height:1.15;letter-spacing:-.02em;margin:0;overflow-wrap:anywhere}
h2{font-size:1.3rem;letter-spacing:-.01em;margin:64px 0 6px}
h3{font-size:1rem;font-weight:600;margin:26px 0 10px;overflow-wrap:anywhere}
p{margin:0 0 14px;max-width:68ch}
.lead,.note{color:var(--soft)}
.lead{margin:8px 0 26px}
.note{font-size:.9rem}
a{color:var(--accent)}
figure{margin:0;min-width:0}
figcaption{font-size:.82rem;color:var(--soft);padding-top:6px;line-height:1.35}
.tile{background:var(--tile);border-radius:10px;overflow:hidden}
.tile img{display:block;width:100%;height:auto}
.row{display:grid;gap:12px}
.six{grid-template-columns:repeat(6,1fr)}
.five{grid-template-columns:repeat(5,1fr)}
.four{grid-template-columns:repeat(4,1fr)}
.three{grid-template-columns:repeat(3,1fr)}
.two{grid-template-columns:repeat(2,1fr)}
.environment{grid-template-columns:2fr 1fr;max-width:800px}.environment figure:only-child{max-width:260px}
.key{display:grid;grid-template-columns:repeat(auto-fit,minmax(128px,1fr));gap:1px;background:var(--line);
border:1px solid var(--line);border-radius:12px;overflow:hidden;margin:26px 0 0;padding:0}
.key div{background:var(--card);padding:14px 16px}
.key dt{font-size:.8rem;color:var(--soft)}
.key dd{margin:2px 0 0;font-size:1.5rem;font-weight:600;letter-spacing:-.02em;line-height:1.2;white-space:nowrap}
.key small{font-size:.85rem;font-weight:400;color:var(--soft);letter-spacing:0;margin-left:3px}
.split{display:grid;grid-template-columns:minmax(0,360px) minmax(0,1fr);gap:28px;align-items:center;margin-top:14px}
.stack{position:relative;isolation:isolate}
.stack img+img{position:absolute;inset:0;mix-blend-mode:plus-lighter}
input[type=range]{width:100%;max-width:360px;accent-color:var(--accent);margin:6px 0}
label{font-weight:600;display:block}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,420px),1fr));gap:24px}
.charts h3{margin-bottom:4px}
svg.chart{display:block;width:100%;max-width:620px;height:auto;font:13px system-ui,-apple-system,sans-serif}
.chart text{fill:var(--soft)}
.chart .grid{stroke:var(--line)}
.chart .axis{stroke:var(--soft)}
.chart line.stage{stroke:var(--soft);stroke-dasharray:3 4;opacity:.7}
.chart text.stage{font-size:11.5px}
.chart .line{fill:none;stroke-width:2.2;stroke-linejoin:round;stroke-linecap:round}
.chart .line.a{stroke:var(--a)}.chart .line.b{stroke:var(--b)}
.chart .dot.a{fill:var(--a)}.chart .dot.b{fill:var(--b)}
.chart text.label{font-weight:600}
.chart text.label.a{fill:var(--a)}.chart text.label.b{fill:var(--b)}
.cameras{margin-top:14px}.camera{fill:none;stroke:var(--a);stroke-width:1.5}.camera.bad{fill:var(--b);stroke:var(--b)}
.missing{fill:none;stroke:var(--b);stroke-width:2}
.legend{display:flex;gap:10px;align-items:center;font-size:.85rem;color:var(--soft);margin-top:12px;flex-wrap:wrap}
.legend svg{width:min(260px,50vw);height:12px;border-radius:6px;display:block}
.wide{overflow-x:auto;border:1px solid var(--line);border-radius:12px;background:var(--card);margin-top:12px}
table{border-collapse:collapse;width:100%;font-size:.92rem}
th,td{text-align:left;vertical-align:top;padding:10px 16px;border-top:1px solid var(--line)}
thead th{color:var(--soft);font-weight:500;font-size:.82rem}
thead th,table:not(:has(thead)) tr:first-child>*{border-top:0}
tbody th{font-weight:600}
td.n{font-variant-numeric:tabular-nums;white-space:nowrap;font-weight:600}
td.w{color:var(--soft)}
details{margin-top:14px}
summary{cursor:pointer;color:var(--soft)}
pre{white-space:pre-wrap;overflow-wrap:anywhere;background:var(--tile);border-radius:10px;padding:14px 16px;
font:13px/1.5 ui-monospace,Menlo,Consolas,monospace;margin:12px 0;max-height:28em;overflow-y:auto}
td,th{overflow-wrap:anywhere}
footer{padding:56px 20px 40px;color:var(--soft);font-size:.85rem}
@media (max-width:820px){.six,.five,.three{grid-template-columns:repeat(3,1fr)}.row{gap:8px}
.split{grid-template-columns:1fr;gap:16px}}
@media (max-width:560px){main,header,footer{padding-left:16px;padding-right:16px}header{padding-top:28px}
.four{grid-template-columns:repeat(2,1fr)}h2{margin-top:48px}.tile{border-radius:7px}
.key{grid-template-columns:repeat(2,1fr)}.key div:last-child:nth-child(odd){grid-column:1/-1}
.hero{grid-template-columns:repeat(2,1fr)}
th,td{padding:8px 10px}.words tr{display:grid;grid-template-columns:1fr auto}.words tr>*{border-top:0}
.words tr{border-top:1px solid var(--line)}.words td.w{grid-column:1/-1;padding-top:0}.words thead{display:none}
.words tbody tr:first-child{border-top:0}}
@media print{.wide{break-inside:avoid}}
"""

# Without scripts, the page shows the sum of both lights, and only the slider has no effect.
SCRIPT = """
for(const s of document.querySelectorAll('input[data-fade]'))s.addEventListener('input',()=>{
document.getElementById(s.dataset.fade).style.opacity=s.value/100})
"""
