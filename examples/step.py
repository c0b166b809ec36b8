import pam_orthosis as po

p = po.parameters("steps", {"control.position.c1": 30.0, "scenario.duration": 4.0})
run = po.simulate(p)  # with the cascade of controllers
verdict = po.check(run)
print(f"maximum error {verdict.max_abs_error:.2f} deg, RMS {verdict.rms_error:.2f} deg")
run.plot().save("step.png")
run.save("bag")  # for all commands
table = run.to_pandas()  # or run["angle"], an array
print(f"extensor at most {table['extensor_pressure'].max() / 1e5:.2f} bar")
